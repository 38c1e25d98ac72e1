"""Pulses for commands that the motors do not follow."""

import random

import pytest
from kit.described import described

from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.dead_zone import PULSE_TICKS, DeadZone, Pulse, pulsed
from rover_ncp.robot.description import DeadBand
from rover_ncp.robot.profile import RoverProfile

BAND = RoverProfile(name="band", dead_band_v=0.05, dead_band_omega=0.1)
BURGER = described("turtlebot3-burger", motion={"dead_band": DeadBand(v=0.02, omega=0.3)})


@pytest.mark.parametrize("wanted", [0.001, -0.012, 0.03, -0.049])
def test_pulses_are_right_on_average_and_as_long_as_the_base_needs(wanted):
    pulse, sent = Pulse(), []
    for _ in range(1000):
        pulse = pulsed(wanted, 0.05, pulse)
        sent.append(pulse.sent)
    assert set(sent) <= {0.0, 0.05 if wanted > 0 else -0.05}
    assert sum(sent) == pytest.approx(1000 * wanted, abs=0.05 * PULSE_TICKS)
    lengths = [len(run) for run in "".join("x" if each else " " for each in sent).split()]
    assert min(lengths[:-1]) >= PULSE_TICKS


@pytest.mark.parametrize(
    ("zone", "v", "omega"),
    [
        (DeadZone(BAND), 0.05, 0.1),
        (DeadZone(None, BURGER), 0.02, 0.3),
        (DeadZone(BAND, BURGER), 0.05, 0.1),  # the measured one counts
        (DeadZone(RoverProfile(name="v", dead_band_v=0.0), BURGER), 0.0, 0.3),
    ],
)
def test_no_command_is_within_the_band(zone, v, omega):
    draw = random.Random(1)
    for _ in range(500):
        sent = zone.pass_on(Velocity(draw.gauss(0, 0.05), draw.gauss(0, 0.1)))
        assert sent.v == 0.0 or abs(sent.v) >= v
        assert sent.omega == 0.0 or abs(sent.omega) >= omega


def test_no_wheel_is_slower_than_its_least_speed():
    robot = described("turtlebot3-burger", motion={"wheel_min": 0.03})
    zone, half, draw = DeadZone(None, robot), robot.half_track_m, random.Random(1)
    for _ in range(500):
        sent = zone.pass_on(Velocity(draw.gauss(0, 0.03), draw.gauss(0, 0.2)))
        for wheel in (sent.v - sent.omega * half, sent.v + sent.omega * half):
            assert abs(wheel) < 1e-12 or abs(wheel) > 0.03
