import math

import numpy as np
import pytest

from rover_ncp.circuit.policy import course_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.course.course import load_course
from rover_ncp.robot.profile import RoverProfile
from sim.learn.rollout import rollout
from sim.world.described import default_rover
from sim.world.motion_errors import BaseErrors, apply_base_errors
from sim.world.random_course import random_course
from sim.world.randomization import (
    Randomization,
    draw_trials,
    load_randomization,
    trial_model,
)

MODEL = default_rover()
TRACKER = course_policy(load_circuit("tap_withdrawal"))
TICKS = 320
N = 400


def drawn(name, count=N, seed=1, first=0):
    return draw_trials(load_randomization(name), MODEL, seed, count=count, ticks=TICKS, first=first)


def test_parameters_fill_the_ranges_of_the_file_and_no_more():
    trials = drawn("harsh")
    for values, low, high in (
        (trials.start[:, :2], -0.1, 0.1),
        (trials.start[:, 2], -math.radians(10), math.radians(10)),
        (trials.delay / 100, 0.05, 0.30),
        (trials.acceleration, 0.7, 1.3),
        (trials.gain, 0.9, 1.1),
        (trials.odometry, 0.97, 1.03),
    ):
        assert low - 1e-6 <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high + 1e-6
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.06 * (high - low))
    assert trials.noise.std(axis=(0, 1)) == pytest.approx([0.005, 0.005, math.radians(0.5)], rel=0.01)
    assert trials.lost.mean() == pytest.approx(0.15, abs=0.004)
    ends = trials.lost[:, :-1] & ~trials.lost[:, 1:]
    assert trials.lost[:, :-1].sum() / ends.sum() == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize("name", ["harsh", "docking"])
def test_longer_drives_continue_the_same_trials(name):
    ranges = load_randomization(name)
    short, long = (draw_trials(ranges, MODEL, 1, count=5, ticks=ticks) for ticks in (TICKS, 2 * TICKS))
    for field, values in short._asdict().items():
        longer = getattr(long, field)
        if field in {"noise", "age", "lost"}:
            longer = longer[:, : values.shape[1]]
        assert np.array_equal(values, longer), field


@pytest.mark.parametrize(("sensors", "sees"), [("encoders", 0), ("gyro", 1), ("camera", 2)])
def test_sensors_see_through_the_skid(sensors, sees):
    ranges = Randomization(name="x", turn_gain=(1.3, 1.3), rotation_center_m=0.06, sensors=sensors)
    course = load_course("parking")
    run = rollout(TRACKER, course, trials=draw_trials(ranges, MODEL, 1, count=1, ticks=course.ticks))
    off = np.abs(run.seen - run.poses[:-1])
    assert (off[:, 2].max() < 1e-9) == (sees >= 1)
    assert (off[:, :2].max() < 1e-9) == (sees == 2)


def test_known_odometry_holds_whatever_the_turn_gain():
    known = RoverProfile(
        name="mine", odometry_heading=0.8, gain_omega=0.9, alpha=1.0, wheel_mismatch_rad_m=-0.03, slip_s=0.3
    )
    ranges = load_randomization("skid").model_copy(update={"rover": known})
    trials = draw_trials(ranges, MODEL, 1, count=5, ticks=TICKS)
    gain = trials.turning[:, 0]
    assert len(np.unique(gain)) == 5
    assert trials.odometry[:, 1] / gain == pytest.approx(0.8)
    assert trials.gain[:, 1] * trials.odometry[:, 1] == pytest.approx(0.9)
    assert [trial_model(MODEL, trials, row).alpha * gain[row] for row in range(5)] == pytest.approx([1.0] * 5)
    # The simulator has slip and wheel mismatch of the wheels' turn, a profile of the true one.
    wheels = 0.4 / gain
    odometry = trials.odometry[:, 1] * (wheels + trials.slip * wheels**2 - trials.wheel_mismatch * 0.2)
    assert odometry == pytest.approx(0.8 * (0.4 + 0.3 * 0.4**2 + 0.03 * 0.2))


def test_a_trial_is_the_same_in_any_company():
    together = drawn("harsh", 6)
    alone = drawn("harsh", 2, first=3)
    for a, b in zip(together, alone, strict=True):
        if np.ndim(a) and len(a) == 6:
            assert np.array_equal(a[3:5], b)
    assert not np.array_equal(together.start, drawn("harsh", 6, seed=2).start)
    assert len({tuple(row) for row in together.start}) == 6


DEAD_BAND = {"dead_band_v": 0.05, "dead_band_omega": 0.1}
STANDS = {"wheel_min": 0.03, "slow_wheel": 0.0, "half_track": 0.1}
TURNS = STANDS | {"slow_wheel": 0.03}


@pytest.mark.parametrize(
    ("errors", "command", "moves"),
    [
        ({"gain_v": 1.1, "gain_omega": 0.9}, (0.1, -0.2), (0.11, -0.18)),
        ({"wheel_mismatch": 0.03}, (0.1, 0.0), (0.1, 0.003)),
        ({"slip": 0.3}, (0.0, 0.2), (0.0, 0.2 * (1 - 0.06))),
        (DEAD_BAND, (0.049, 0.2), (0.0, 0.2)),
        (DEAD_BAND, (0.05, -0.099), (0.05, 0.0)),
        (STANDS, (0.02, 0.0), (0.0, 0.0)),
        (STANDS, (0.05, 0.3), (0.04, 0.4)),  # wheels at 0.02 and 0.08 m/s
        (TURNS, (0.02, 0.0), (0.03, 0.0)),
        (TURNS, (0.05, 0.3), (0.055, 0.25)),
    ],
)
def test_what_a_base_makes_of_a_command(errors, command, moves):
    base = BaseErrors(1.0, 1.0, 0.0, 0.0)._replace(**errors)
    assert apply_base_errors(*command, base, (0.0, 0.0)) == pytest.approx(moves, abs=1e-15)


def test_random_courses_are_their_seeds_and_numbers():
    course, drive = random_course(3, 7)
    again, _ = random_course(3, 7)
    other, _ = random_course(3, 8)
    assert course == again
    assert course.checkpoints != other.checkpoints
    assert drive.ticks == course.ticks == 320
    for point in course.checkpoints:
        pose, _ = drive.at(point.t)
        assert pose == pytest.approx(point.pose, abs=1e-6)
    for number in range(50):
        _, drive = random_course(3, number)
        assert 0.2 < np.abs(np.diff(drive.poses[:, :2], axis=0)).sum() < 5
        assert not drive.motion[-90:].any()
        assert not drive.motion[:5].any()


def test_stiction_narrows_the_dead_band_of_a_moving_base():
    base = BaseErrors(1.0, 1.0, 0.0, 0.0, stiction=0.4)._replace(**DEAD_BAND)
    assert apply_base_errors(0.04, 0.08, base, (0.1, 0.0)) == (0.04, 0.0)
    assert apply_base_errors(0.04, 0.08, base, (0.0, -0.2)) == (0.0, 0.08)
