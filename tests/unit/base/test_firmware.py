"""The mock Pioneer as the manuals say a base behaves."""

import math

import pytest
from kit.pioneer_bench import Pioneer

from bridge.pioneer.framing import Command
from bridge.pioneer.packets import Flag
from sim.base.client_commands import MockCommand


@pytest.fixture
def pioneer() -> Pioneer:
    """A base with an open session, its motors on."""
    return Pioneer().open()


def test_speeds_rise_within_the_acceleration_limits_after_the_delays(pioneer: Pioneer) -> None:
    pioneer.tell(Command.VEL, 200)
    pioneer.obey(0.10, Command.RVEL, 30)
    assert (pioneer.speed, pioneer.turn_deg_s) == (0.0, 0.0)
    pioneer.run(0.05)
    assert pioneer.speed == 0.0
    assert pioneer.turn_deg_s == pytest.approx(math.degrees(1.25 * 0.05), rel=1e-3)
    pioneer.run(0.10)
    assert pioneer.speed == pytest.approx(0.31 * 0.10, rel=1e-2)
    pioneer.obey(0.10, Command.SETA, 1000)
    assert pioneer.speed == pytest.approx(0.031 + 0.100, rel=1e-2)
    pioneer.run(1.0)
    pioneer.tell(Command.SETA, -100)
    pioneer.drive(0, 1.15)
    assert pioneer.speed == pytest.approx(0.1, rel=1e-2)


def test_watchdog_halts_and_any_packet_resumes_the_setpoints(pioneer: Pioneer) -> None:
    pioneer.drive(200, 1.9, fed=False)
    assert pioneer.speed == pytest.approx(0.2)
    pioneer.run(1.5, fed=False)
    assert pioneer.speed == 0.0
    pioneer.packets.clear()
    pioneer.run(1.0, fed=False)
    assert [bool(sip.flags & Flag.MOTORS) for sip in pioneer.sips()] == [True] * 10
    pioneer.tell(62, 1)  # BATTERYINFO
    pioneer.run(1.5)
    assert pioneer.speed == pytest.approx(0.2)


def test_headings_are_absolute_relative_and_relative_to_the_setpoint(pioneer: Pioneer) -> None:
    for command, argument, heading in [
        (MockCommand.HEAD, 90, 90),
        (MockCommand.DHEAD, -30, 60),
        (MockCommand.DCHEAD, 150, -150),
        (MockCommand.DCHEAD, 20, -130),
        (MockCommand.HEAD, 350, -10),
    ]:
        pioneer.obey(8.0, command, argument)
        assert math.degrees(pioneer.rover.pose.theta) == pytest.approx(heading, abs=0.8), command
    pioneer.obey(2.0, MockCommand.ROTATE, 10)
    assert pioneer.turn_deg_s == pytest.approx(10, rel=1e-3)


def test_a_wall_stalls_the_wheels_and_odometry_does_not_run_on() -> None:
    pioneer = Pioneer(wall_x=1.0).open()
    pioneer.drive(200, 6.0)
    stalled = [sip for sip in pioneer.sips() if sip.stall_left & 1 and sip.stall_right & 1]
    assert stalled
    assert not any(sip.stall_left & 1 for sip in pioneer.sips()[:20])
    assert pioneer.rover.pose.x == pytest.approx(1.0 - 0.1 - 0.313, abs=0.003)
    assert pioneer.firmware.drive.odometry.x == pytest.approx(pioneer.rover.pose.x, abs=0.03)
    pioneer.drive(-200, 2.0)
    assert pioneer.rover.pose.x < 0.5
    assert not pioneer.sip().stall_left & 1


def test_sonars_measure_the_wall_and_follow_commands() -> None:
    pioneer = Pioneer(wall_x=1.0).open()
    pioneer.run(1.0)
    heard = dict(reading for sip in pioneer.sips() for reading in sip.sonar)
    assert set(heard) == set(range(16))
    ahead = 0.9 - 0.245
    assert heard[3] == pytest.approx(1000 * ahead / math.cos(math.radians(10)), abs=2)
    assert heard[0] == 5000
    pioneer.obey(0.2, Command.SONAR, 0)
    assert pioneer.sip().sonar == ()
    assert not pioneer.sip().flags & Flag.SONAR_1
    pioneer.tell(Command.SONAR, 0b101)
    pioneer.obey(0.2, MockCommand.POLLING, bytes([9, 10]))
    assert {number for number, _ in pioneer.sip().sonar} <= {8, 9}
    assert pioneer.sip().flags & (Flag.SONAR_1 | Flag.SONAR_2) == Flag.SONAR_2
