"""The gate: no motion from which the rover would stop outside the fence, also on an arc."""

import math
import random

import pytest
from kit.gate_bench import BOX, LIMITS, Gate
from pydantic import ValidationError

from bridge.base import BaseReport
from bridge.gate.limits import Fence, Limits
from bridge.gate.motion import leaves
from bridge.gate.state import Reason
from rover_ncp.core.geometry import STANDSTILL, Velocity

LANE = Fence(x_min=-9.0, x_max=9.0, y_min=-1.0, y_max=1.0)
BRAKE = 0.25
FENCED = LIMITS.model_copy(update={"fence": BOX})


def held(base, velocity, age_s=0.0, fence=BOX):
    return leaves(fence, base, velocity, age_s, BRAKE)


# The arc


@pytest.mark.parametrize(
    ("velocity", "room"),
    [
        # 0.9 s at 0.3 m/s and 0.6 rad/s: an arc of 0.54 rad with a radius of 0.5 m
        (Velocity(0.3, 0.6), 0.5 * (1.0 - math.cos(0.54))),
        # A whole circle; at half of the turn rate it is twice as large.
        (Velocity(1.2, 3.0), 1.6),
    ],
)
def test_arc_of_the_stop_stays_inside(velocity, room):
    for y, v, omega in ((1.0, *velocity), (-1.0, velocity.v, -velocity.omega)):
        inside, outside = y * (0.999 - room), y * (1.001 - room)
        assert not held(BaseReport(y=inside), Velocity(v, omega), fence=LANE)
        assert held(BaseReport(y=outside), Velocity(v, omega), fence=LANE)
        # As long as the rover still turns, the command to drive straight on is not enough.
        assert not held(BaseReport(y=inside, omega=omega), Velocity(v, 0.0), fence=LANE)
        assert held(BaseReport(y=outside, omega=omega), Velocity(v, 0.0), fence=LANE)
        if abs(v) < 1.0:
            assert not held(BaseReport(y=outside), Velocity(v, -omega), fence=LANE)


@pytest.mark.parametrize(("rolling", "way"), [(0.3, 0.27), (0.05, 0.02), (5.0, 3.24), (-0.3, 0.27)])
def test_rolling_rover_needs_the_way_of_its_own_speed(rolling, way):
    slow = Velocity(math.copysign(0.001, rolling), 0.0)
    for room, leaving in ((way - 0.001, True), (way + 0.001, False)):
        base = BaseReport(x=math.copysign(9.0 - room, rolling), v=rolling)
        assert held(base, slow, fence=LANE) is leaving
        assert not held(base, STANDSTILL, fence=LANE)


def test_noise_of_a_standing_rover_holds_nothing():
    assert not held(BaseReport(x=2.0, v=math.nextafter(0.05, 0.0)), Velocity(0.0, 0.3))
    assert held(BaseReport(x=2.0, v=0.05), Velocity(0.0, 0.3))


@pytest.mark.parametrize(("age_s", "reason"), [(0.0, None), (0.2, Reason.GEOFENCE)])
def test_how_late_a_report_arrived_counts(age_s, reason):
    gate = Gate(FENCED).driving()
    gate.place(
        0.02, BaseReport(x=1.95, v=0.1, age_s=age_s)
    )  # at 0.1 m/s it needs 0.05 m within 0.3 s of reaction
    assert gate.drive(0.02, Velocity(0.05, 0.0)).held is reason


def reference(base, v, omega):
    """How far the arc of a stop leads outside, in fine steps."""
    x, y, theta, worst = base.x, base.y, base.theta, -1.0
    step_s = (0.3 + abs(v) / (2 * BRAKE)) / 500
    for _ in range(500):
        theta += omega * step_s / 2
        x, y = x + v * step_s * math.cos(theta), y + v * step_s * math.sin(theta)
        theta += omega * step_s / 2
        worst = max(worst, BOX.x_min - x, x - BOX.x_max, BOX.y_min - y, y - BOX.y_max)
    return worst


def test_random_arcs_agree_with_fine_steps():
    dice, decided = random.Random(1), 0
    for _ in range(400):
        base = BaseReport(x=dice.uniform(-1, 2), y=dice.uniform(-1, 1), theta=dice.uniform(-4, 4))
        velocity = Velocity(dice.uniform(-1, 1), dice.uniform(-3, 3))
        worst = max(reference(base, velocity.v, share * velocity.omega) for share in (0.0, 0.5, 1.0))
        if abs(worst) > 0.002:
            decided += 1
            assert held(base, velocity) is (worst > 0.0)
    assert decided > 380


# A rover with a delay, the least braking, and reports ten times a second


def drive_along(y, theta, command, seconds=6.0, delay_s=0.2):
    """Return the largest y of a rover that is driven by the gate's output, from full speed on."""
    gate, pending = Gate(FENCED).driving(), []
    x = v = omega = 0.0
    begin = now = 0.02
    worst = y
    while now < begin + seconds:
        if round(now * 50) % 5 == 0:
            report = BaseReport(x=x, y=y, theta=theta, v=v, omega=omega)
            gate.at(now, report) if now > begin else gate.place(now, report)
        gate.drive(now, command(now - begin))
        pending.append((now + delay_s, gate.state.out))
        wanted = next((out for due, out in reversed(pending) if due <= now), STANDSTILL)
        for _ in range(20):
            v += min(max(wanted.v - v, -0.3e-3), 1e-3)
            omega += min(max(wanted.omega - omega, -1.25e-3), 1.25e-3)
            theta += omega * 1e-3
            x, y = x + v * 1e-3 * math.cos(theta), y + v * 1e-3 * math.sin(theta)
            worst = max(worst, y)
        now += 0.02
    return worst


@pytest.mark.parametrize(("v", "omega"), [(0.3, 0.6), (0.05, -0.6), (-0.3, 0.6)])
def test_rover_at_speed_whose_command_changes_stays_inside(v, omega):
    def command(t):
        return Velocity(0.3, 0.0) if t < 2.0 else Velocity(v, omega)

    assert drive_along(0.97, 0.0, command) <= 1.0
    assert drive_along(0.4, 0.2, command) <= 1.0


def test_driving_with_noise_and_with_late_and_lost_reports_is_no_jump():
    """Each speed may change at once; 2 % of reports are 0.3 s late and hold up those behind them."""
    dice, gate = random.Random(0), Gate(FENCED)
    x = y = theta = v = omega = arrival = 0.0
    for k in range(3000):
        if k % 20 == 0:
            v, omega = dice.uniform(-0.3, 0.3), dice.uniform(-0.6, 0.6)
        theta += omega * 0.1
        x, y = x + v * 0.1 * math.cos(theta), y + v * 0.1 * math.sin(theta)
        if dice.random() < 0.02:
            continue
        arrival = max(arrival, 0.1 * k + dice.uniform(0.0, 0.03) + (0.3 if dice.random() < 0.02 else 0.0))
        pose = (value + dice.gauss(0.0, 0.005) for value in (x, y, theta))
        gate.at(arrival, BaseReport(*pose, v + dice.gauss(0.0, 0.02), omega + dice.gauss(0.0, 0.02)))
        assert not gate.state.odometry_restarted


# Limits: no setting undoes the first safety requirement


STOP_S = 0.5


def test_fence_measures_the_distance_of_points_outside():
    points = [(0.0, 0.0), (2.0, 1.0), (2.5, 0.0), (-1.25, 0.0), (0.0, 1.5), (3.0, -3.0)]
    assert [BOX.outside(*point) for point in points] == [0.0, 0.0, 0.5, 0.25, 0.5, 2.0]


@pytest.mark.parametrize(
    ("x_min", "x_max", "y_min", "y_max"),
    [
        (1.0, 1.0, 0.0, 1.0),
        (2.0, 1.0, 0.0, 1.0),
        (0.0, 1.0, 1.0, 1.0),
        (-100_000.5, 1.0, 0.0, 1.0),
        (0.0, 100_000.5, 0.0, 1.0),
    ],
)
def test_a_fence_without_an_inside_or_beyond_100_km_is_refused(x_min, x_max, y_min, y_max):
    with pytest.raises(ValidationError, match=r"a fence needs|than or equal to -?100000"):
        Fence(x_min=x_min, x_max=x_max, y_min=y_min, y_max=y_max)


@pytest.mark.parametrize("name", ["command_timeout_s", "stale_s", "odometry_s"])
@pytest.mark.parametrize("seconds", [STOP_S, 0.0])
def test_no_timeout_may_be_as_long_as_the_requirement_or_zero(name, seconds):
    with pytest.raises(ValidationError):
        Limits(**{name: seconds})
