"""Identification of a simulated robot before its drive, as `rover-ncp identify` with external poses."""

import numpy as np

from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.identify.excitation import FENCE_M, excite
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile
from sim.pioneer.trial import BaseTrial, Drawn
from sim.stack.camera import Camera, Localiser
from sim.stack.lines import simulated_base
from sim.stack.virtual import VirtualBridge, VirtualLink


def identified(
    drawn: Drawn, robot: RobotDescription, camera: Camera, stream: np.random.Generator
) -> RoverProfile:
    """Drive a robot forward and back, left and right, under a camera, and return its profile."""
    base = simulated_base(robot, drawn.rover, BaseTrial(drawn.trials), gyro=False)
    bridge, received = VirtualBridge(base), list[Recorded]()
    link = VirtualLink(bridge, drawn.rover.pose, received.append)
    base.observe = Localiser(camera, drawn.rover, stream, link.localise).observe
    measurements = Measurements(link)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
    monitor.wait()
    excite(link, measurements, monitor, FENCE_M, bridge)
    return identify(motion_log(received, robot), robot.name)
