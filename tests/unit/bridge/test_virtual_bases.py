"""The bridge's loop with bases that misbehave or meet a wall, on a virtual clock."""

import pytest
from kit.amrisim import MODEL, AmriSim
from kit.bridge_bench import BRAKING_M_S2, DELAY_S
from kit.ros2_world import BURGER
from kit.virtual_bench import VirtualDriver, VirtualRig

from bridge.gate.limits import Limits
from rover_ncp.core.geometry import Velocity
from rover_ncp.course.course import Obstacle
from rover_ncp.robot.description import load_description
from sim.pioneer.faults import parse_fault
from sim.pioneer.firmware import ClientState

STOP_S, RECOVERY_S = 0.5, 5.0


@pytest.fixture
def amrisim():
    """AMRISim, as it says what it is, behind a bridge."""
    return VirtualDriver(VirtualRig(load_description(MODEL), firmware=AmriSim))


def test_a_base_whose_motors_are_on_from_the_start_is_driven_and_stopped(amrisim):
    rig, firmware = amrisim.rig, amrisim.rig.base
    # The bridge found motors on without a lease: it switches them off before the first drive.
    rig.wait_for(lambda: firmware.client is ClientState.OPEN and firmware.drive.enabled)
    rig.wait_for(lambda: not firmware.drive.enabled)
    # West across the counter's zero, where 15 and 16 bits disagree: -1 mm is 65535, not 32767.
    amrisim.start(v=-0.15).drive(1.0, v=-0.15)
    assert rig.rover.velocity.v == pytest.approx(-0.15, abs=0.002)
    amrisim.motors(enable=False)
    rig.wait_for(lambda: rig.rover.velocity.v == 0.0 and not firmware.drive.enabled)
    rig.sleep(0.3)
    assert amrisim.odom.pose.x == pytest.approx(rig.rover.pose.x, abs=0.002)
    assert rig.rover.pose.x < -0.1
    assert "tf" in amrisim.seen


def test_silence_stops_a_base_that_has_no_watchdog(amrisim):
    amrisim.start().drive(0.3)
    amrisim.rig.sleep(STOP_S + DELAY_S + 0.15 / BRAKING_M_S2)
    assert amrisim.rig.rover.velocity.v == 0.0


@pytest.mark.parametrize("silent_s", [1.0, 4.0])  # the line is opened again after 2.3 s
def test_a_base_that_falls_silent_is_there_again_soon_after(silent_s):
    driver = VirtualDriver(rig := VirtualRig(load_description("p3at")))
    driver.start()
    for name in ("mute", "deaf"):
        rig.base.inject(parse_fault(f"{name}@0-{silent_s}"))
    began_s = rig.monotonic()
    rig.wait_for(lambda: driver.gate.held == "no-base")
    assert driver.motors().reason == "no-base"
    rig.wait_for(lambda: driver.gate.held != "no-base")
    assert silent_s < rig.monotonic() - began_s < silent_s + RECOVERY_S
    driver.start()


def test_a_ros2_robot_is_driven_within_its_own_speed():
    driver = VirtualDriver(VirtualRig(BURGER))
    driver.start(v=0.2).drive(0.5, v=5.0)
    assert (driver.out, driver.gate.held) == (Velocity(0.22, 0.0), "")  # the e-manual's maximum
    assert driver.gate.limited["speed"] > 0
    assert driver.odom.velocity.v == pytest.approx(0.22, abs=0.02)


def test_a_wall_in_its_scan_stops_a_ros2_robot_and_the_way_back_is_free():
    wall = Obstacle(x=1.05, y=0.0, length=0.1, width=2.0)
    driver = VirtualDriver(
        rig := VirtualRig(BURGER, limits=Limits(v_max=0.22, sonar_stop_m=0.3), walls=[wall])
    )
    driver.start(v=0.2)
    rig.wait_for(lambda: driver.drive(0.1, v=0.2) and driver.gate.held == "sonar")
    assert rig.stands_after(0.5)
    # The wall begins at 1 m, the outline 0.041 m before the centre; a scan is 0.2 s old at most.
    left_m = 1.0 - 0.041 - rig.rover.pose.x
    assert 0.3 - 0.2 * (0.2 + 0.05 + 0.08) - 0.22**2 / 2 / 2.5 < left_m < 0.3
    driver.drive(1.0, v=-0.1)
    assert driver.odom.velocity.v == pytest.approx(-0.1, abs=0.02)
