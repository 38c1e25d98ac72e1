"""The gate: odometry that is frozen, and odometry that restarts or jumps inside a fence."""

import math

import pytest
from kit.gate_bench import BOX, SLOW, Gate, limits, steps

from bridge.gate.state import Reason
from rover_ncp.core.geometry import STANDSTILL

MOTIONS = pytest.mark.parametrize(("pose", "speed"), [("x", "v"), ("theta", "omega")])


@pytest.mark.parametrize("motion", [{"v": 0.05}, {"v": -0.05}, {"omega": 0.1}, {"omega": -0.1}])
def test_frozen_odometry_ends_the_lease(motion):
    gate = Gate().driving()
    gate.report(0.1, x=1.0, **motion)
    assert gate.report(0.2, x=1.0, **motion).held is None
    verdict = gate.report(0.31, x=1.0, **motion)
    assert (verdict.velocity, verdict.held) == (STANDSTILL, Reason.FROZEN)
    assert gate.state.lease_over is Reason.FROZEN
    assert gate.enable(0.35).refusal is Reason.FROZEN
    gate.report(0.4, x=1.001)
    assert gate.enable(0.45).refusal is None


@pytest.mark.parametrize(
    ("motion", "held"),
    [({"v": 0.01}, Reason.FROZEN), ({"omega": 0.02}, Reason.FROZEN), ({"v": 0.0}, Reason.NO_LEASE)],
)
def test_odometry_is_frozen_from_exactly_this_distance_on(motion, held):
    gate = Gate().driving()
    for now in (1.0, 1.5, 2.0):
        verdict = gate.report(now, x=1.0, **motion)
    assert verdict.held is held


def sign(now):
    """Change the sign with each report, as motors do that hold a robot on a slope."""
    return 1.0 - 2.0 * (round(10 * now) // 2 % 2)


@pytest.mark.parametrize(
    ("speed", "refusal"),
    [
        (lambda now: 0.009, None),
        (lambda now: 0.01, Reason.FROZEN),
        (lambda now: 0.014 * sign(now), None),
        (lambda now: 0.02 if round(10 * now) % 2 else -0.011, None),
    ],
    ids=["noise", "slow", "flickers", "rocks"],
)
@pytest.mark.parametrize("name", ["v", "omega"])
def test_noisy_speed_of_a_robot_that_stands_is_no_frozen_odometry(name, speed, refusal):
    gate = Gate()
    for now in steps(0.0, 9.9, 0.1):
        gate.report(now, x=1.0, **{name: speed(now)})
    assert gate.enable(10.0).refusal is refusal


@pytest.mark.parametrize("motion", [{"v": 0.3}, {"omega": 0.6}])
def test_noisy_odometry_may_repeat_a_pose_once(motion):
    gate = Gate().driving()
    for now, x in ((0.1, 1.0), (0.2, 1.0), (0.21, 1.01), (0.25, 1.01)):
        assert gate.report(now, x=x, **motion).held is None
    assert gate.report(0.29, x=1.01, **motion).held is Reason.FROZEN


@pytest.mark.parametrize("name", ["v", "omega"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_frozen_distance_uses_the_slower_of_two_reported_speeds(name, direction):
    gate = Gate().driving()
    for now, speed in ((0.05, 0.19), (0.15, 0.011), (0.25, 0.19), (0.35, 0.011), (0.45, 0.19)):
        verdict = gate.report(now, x=1.0, **{name: direction * speed})
    assert verdict.lease is not None


def means(gate, pose, speed, first, last, velocity=SLOW):
    """Report a robot whose pose stands from 2 s on and whose speeds are means; return the holds."""
    held = []
    for now in steps(first, last, 0.125):
        gate.report(now, **{pose: 0.32 * min(now, 2.0), speed: 0.3})
        held.append(gate.drive(now, velocity).held)
    return held


@MOTIONS
def test_mean_speeds_of_a_robot_that_halts_are_frozen_odometry_only_after_the_time_of_the_mean(pose, speed):
    gate = Gate(limits(speed_mean_s=1.0)).driving()
    held = means(gate, pose, speed, 0.125, 1.25)
    held += means(gate, pose, speed, 1.375, 3.0, STANDSTILL)
    for now in steps(3.125, 4.875, 0.125):
        gate.report(now, **{pose: 0.64})
        held.append(gate.drive(now, STANDSTILL).held)
    held += means(gate, pose, speed, 5.0, 5.0, STANDSTILL)
    assert set(held) == {None}
    assert means(gate, pose, speed, 5.125, 5.125, STANDSTILL) == [Reason.FROZEN]


@pytest.mark.parametrize(
    ("halt", "on", "frozen"),
    [
        (None, 0.125, 2.25),
        (0.875, 1.625, 2.25),
        (1.0, 1.75, 2.875),
    ],
)
@MOTIONS
def test_mean_speeds_are_frozen_odometry_where_the_rover_was_driven_on_after_a_halt(
    pose, speed, halt, on, frozen
):
    """The speeds count after the time of the mean, where the halt ends shortly before the pose stands."""
    gate = Gate(limits(speed_mean_s=1.0)).driving()
    held = []
    if halt is not None:
        held += means(gate, pose, speed, 0.125, halt - 0.125)
        held += means(gate, pose, speed, halt, on - 0.125, STANDSTILL)
    held += means(gate, pose, speed, on, frozen - 0.125)
    assert set(held) == {None}
    assert set(means(gate, pose, speed, frozen, 3.625)) == {Reason.FROZEN}


@MOTIONS
def test_mean_speeds_do_not_excuse_odometry_that_freezes_as_a_rover_that_stood_begins_to_drive(pose, speed):
    gate = Gate(limits(speed_mean_s=1.0)).driving()
    for now in steps(0.125, 1.0, 0.125):
        gate.report(now, **{pose: 0.001 * (round(8 * now) % 2)})  # noise
        gate.drive(now, STANDSTILL)
    for now in steps(1.125, 1.5, 0.125):
        gate.drive(now)
        held = gate.report(now, **{pose: 0.001, speed: 0.1}).held
    assert held is Reason.FROZEN


@pytest.mark.parametrize(
    ("fence", "restarted", "lost"), [(BOX, True, True), (BOX, False, False), (None, True, False)]
)
def test_fence_is_lost_when_odometry_restarts(fence, restarted, lost):
    gate = Gate(limits(fence=fence)).driving()
    assert gate.lost(0.1, restarted=restarted).held is Reason.NO_BASE
    gate.report(0.2)
    assert gate.enable(0.2).refusal is (Reason.FENCE_LOST if lost else None)
    if lost:
        assert gate.drive(0.3).dropped is Reason.FENCE_LOST
        gate.lost(0.4)
        gate.report(0.5)
        assert gate.enable(0.5).refusal is Reason.FENCE_LOST


# Without a command a rover may get to 0.1 m/s and 0.4 rad/s in 0.1 s. Reported speeds count up to 1.2 and 3.
JUMPS = [
    ({"x": 0.089}, 0.1, False),
    ({"x": 0.091}, 0.1, True),
    ({"y": -0.9}, 0.1, True),
    ({"theta": -0.259}, 0.1, False),
    ({"theta": -0.261}, 0.1, True),
    ({"theta": math.tau}, 0.1, False),
    ({"x": -0.251, "v": -0.5}, 0.1, True),
    ({"x": 0.9, "v": 1e308, "omega": 1e308}, 0.1, True),
    ({"theta": 1.301, "omega": 50.0}, 0.1, True),
    ({"x": 0.9, "v": math.nan, "omega": math.nan}, 0.1, True),
    ({"x": 1e308, "v": 0.3}, 0.1, True),
    ({"x": 0.321}, 0.6, True),
    ({"x": 0.05 + 0.7 * (0.5 + 0.3), "v": 0.7}, 0.5, False),
    ({"x": math.nextafter(0.05 + 0.7 * (0.5 + 0.3), 1.0), "v": 0.7}, 0.5, True),
    ({"theta": 0.1 + 0.7 * (0.5 + 0.3), "omega": 0.7}, 0.5, False),
]


@pytest.mark.parametrize(("other", "seconds", "lost"), JUMPS)
@pytest.mark.parametrize("back", [False, True])
def test_fence_is_lost_when_a_pose_jumps_farther_than_the_rover_can_move(other, seconds, lost, back):
    first, then = (other, {}) if back else ({}, other)
    for fence in (BOX, None):
        gate = Gate(limits(fence=fence))
        gate.report(1.0, **first)
        gate.report(1.0 + seconds, **then)
        finite = all(map(math.isfinite, then.values()))
        refusal = Reason.FENCE_LOST if lost and fence else None if finite else Reason.ODOMETRY
        assert gate.enable(1.0 + seconds).refusal is refusal
        if refusal is Reason.FENCE_LOST:  # also when no further pose jumps
            gate.report(1.1 + seconds, **then)
            assert gate.enable(1.1 + seconds).refusal is refusal


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("field", ["x", "y", "theta"])
def test_fence_is_lost_when_a_pose_becomes_finite_again(field, value):
    gate = Gate(limits(fence=BOX)).driving()
    gate.report(0.1, **{field: value})
    assert gate.drive(0.1).held is Reason.ODOMETRY
    verdict = gate.report(0.2)
    assert (verdict.held, gate.state.lease_over) == (Reason.FENCE_LOST, Reason.FENCE_LOST)
