"""A robot on the virtual clock and the check of it."""

from deploy.check import Preflight
from deploy.check_inputs import Battery
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from kit.virtual_drive import ChangedLink
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.robot.description import load_description
from sim.base.faults import Faults, parse_fault
from sim.base.firmware import Firmware
from sim.base.ros2_robot import Ros2Robot
from sim.stack.virtual import VirtualBridge
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover


def check(
    *faults,
    limits=None,
    while_turning="",
    model=None,
    robot="p3at-sh",
    config=None,
    clock_rate=1.0,
    odometry=lambda data: data,
):
    """Check a robot on the virtual clock; return the findings, the link and the rover."""
    robot = load_description(robot) if isinstance(robot, str) else robot
    rover = PymunkRover(described_rover(robot, motors=True), Ground(()))
    if robot.arcos:
        base = Firmware(robot, rover, faults=Faults([parse_fault(fault) for fault in faults]), config=config)
    else:
        base = Ros2Robot(robot, rover)
        base._stamp_ns = lambda: round(clock_rate * base.now * NS_PER_S)
    bridge, battery = VirtualBridge(base, limits), Battery()
    bridge.sleep(3.0)
    link = ChangedLink(bridge, battery.record)
    link._start = None  # no poses
    measurements = Measurements(link, pose_frame=None)

    def press_bumper(data):
        if while_turning and rover.velocity.omega > 0.05:
            base.inject(parse_fault(while_turning))
        return odometry(data)

    link.change["odom"] = press_bumper
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
    monitor.wait()
    expected = load_description(model) if isinstance(model, str) else model
    preflight = Preflight(link, measurements, monitor, battery, robot=expected, clock=bridge)
    return preflight.run(), link, rover
