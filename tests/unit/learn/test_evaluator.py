"""Episodes of the native library against the plain rollout and the Gymnasium environment, to the last bit."""

from typing import get_args

import gymnasium
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from kit.toy_search import POLICY, candidates
from kit.wirings import in_bounds

from rover_ncp.circuit.policy import course_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import wrap_angle
from rover_ncp.course.course import Obstacle, load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.scoring import due_checkpoints
from sim.learn.evaluator import Evaluator
from sim.learn.rollout import rollout
from sim.learn.search import Batch
from sim.world.described import default_rover
from sim.world.env import ENV_ID
from sim.world.random_course import random_course
from sim.world.randomization import Sensors, draw_trials, load_randomization

PARKING = load_course("parking")
COURSE = PARKING.model_copy(
    update={"horizon_s": 12.0, "checkpoints": tuple(point for point in PARKING.checkpoints if point.t <= 12)}
)
"""The first turn of the paper's course."""
TRACKER = course_policy(load_circuit("tap_withdrawal"))
FENCED = COURSE.model_copy(
    update={
        "obstacles": (
            Obstacle(x=0.6, y=0.0, length=0.1, width=1.2),
            Obstacle(x=0.0, y=0.6, theta=0.1, length=2.0, width=0.1),
            Obstacle(x=0.0, y=-0.6, theta=-0.1, length=2.0, width=0.1),
        )
    }
)


def alone(vector, course=COURSE, model=None):
    return rollout(POLICY.with_parameters(vector), course, model)


@pytest.mark.parametrize("course", [COURSE, FENCED], ids=["open", "fenced"])
def test_a_lane_returns_what_a_rover_alone_returns(course):
    vectors = candidates(28)  # more than lanes, so lanes are used again, after collisions, too
    runs = [alone(vector, course) for vector in vectors]
    assert Evaluator(POLICY, course).returns(vectors).tolist() == [run.total for run in runs]
    assert any(run.touched for run in runs) == bool(course.obstacles)
    assert len({run.total for run in runs}) > 20


def test_a_lane_returns_what_the_environment_returns():
    env = gymnasium.make(ENV_ID, course=COURSE).unwrapped
    vectors = candidates(3, seed=1)
    returns = []
    for vector in vectors:
        runner = Runner(POLICY.with_parameters(vector))
        observation, _ = env.reset()
        runner.tick(observation)
        total, terminated = 0.0, False
        while not terminated:
            observation, reward, terminated, _, _ = env.step(runner.tick(observation))
            total += reward
        returns.append(total)
    assert Evaluator(POLICY, COURSE).returns(vectors).tolist() == returns


def test_misses_are_those_of_a_rover_alone_and_make_up_the_return():
    vectors = candidates(10, seed=8)
    stream = Evaluator(POLICY, FENCED).stream(1)
    stream.submit(0, Batch(vectors, np.full(10, -np.inf)))
    [(_, (returns, residuals))] = stream.collect()
    due = due_checkpoints(FENCED)
    assert residuals.shape == (10, len(FENCED.checkpoints), 3)
    for vector, total, episode in zip(vectors, returns, residuals, strict=True):
        run = alone(vector, FENCED)
        expected = np.zeros_like(episode)
        for tick in np.flatnonzero(due >= 0):
            at, target = run.poses[tick + 1], FENCED.checkpoints[due[tick]].pose
            expected[due[tick]] = at[0] - target.x, at[1] - target.y, wrap_angle(at[2] - target.theta)
        assert episode.tolist() == expected.tolist()
        assert total == run.total
        assert -np.sum(episode**2) == pytest.approx(total, rel=1e-14)


def test_a_lost_race_is_stopped_and_no_other_is_touched():
    engine, vectors = Evaluator(POLICY, COURSE), candidates(60, seed=3)
    returns, stream = engine.returns(vectors), engine.stream(1)
    thresholds = np.where(np.arange(60) % 3 == 0, returns, np.median(returns))  # its own return is no loss
    stream.submit(0, Batch(vectors, thresholds))
    [(_, (raced, _))] = stream.collect()
    lost = returns < thresholds
    assert 10 < lost.sum() < 50
    assert np.array_equal(raced[~lost], returns[~lost])
    assert (raced[lost] < thresholds[lost]).all()
    assert (raced[lost] >= returns[lost]).all()
    assert (raced[lost] > returns[lost]).any()


MOTORS = {
    "dead_band_m_s": (0.01, 0.06),
    "dead_band_rad_s": (0.01, 0.14),
}


@pytest.mark.parametrize("policy", [POLICY, TRACKER], ids=["absolute", "course"])
@pytest.mark.parametrize(
    ("level", "changed"),
    [
        ("none", {}),
        ("full", {}),
        ("full", MOTORS),
        *(("skid", {"sensors": each}) for each in get_args(Sensors)),
    ],
)
def test_trials_end_as_a_rover_alone_does(policy, level, changed):
    model = default_rover(
        **({"slow_wheels_turn": True, "wheel_min": 0.02, "stiction": 0.3} if changed else {})
    )
    ranges = load_randomization(level).model_copy(update=changed)
    trials = draw_trials(ranges, model, 5, count=2, ticks=COURSE.ticks)
    vectors = candidates(2, seed=5, policy=policy)
    found = Evaluator(policy, COURSE, model, trials).outcomes(vectors)
    reference = plan_reference(COURSE)
    for i, vector in enumerate(vectors):
        for j in range(trials.size):
            run = rollout(policy.with_parameters(vector), COURSE, model, trials=trials, row=j)
            assert found.total[i, j] == run.total
            assert found.parked[i, j] == run.verdict.parked
            assert found.error_m[i, j] == pytest.approx(run.verdict.error_m, abs=1e-12)
            assert found.error_rad[i, j] == pytest.approx(run.verdict.error_rad, abs=1e-12)
            if policy is TRACKER:
                away = run.poses[1:, :2] - reference.poses[1:, :2]
                assert found.tracking_m2[i, j] == pytest.approx(np.mean(np.sum(away**2, axis=1)), rel=1e-3)
            tail = run.poses[-21:]
            moved = np.hypot(*(tail[:, :2] - tail[-1, :2]).T).max()
            assert found.moved_m[i, j] == pytest.approx(moved, abs=1e-12)
            turned = max(abs(wrap_angle(heading - tail[-1, 2])) for heading in tail[:, 2])
            assert found.turned_rad[i, j] == pytest.approx(turned, abs=1e-12)
    assert len(np.unique(found.total)) == (2 if level == "none" else 4)


def test_courses_and_trials_in_one_batch_as_each_alone():
    model = default_rover()
    pairs = [random_course(1, 0), random_course(1, 1)]
    short = pairs[0][0].model_copy(update={"horizon_s": 30.0, "checkpoints": pairs[0][0].checkpoints[:-1]})
    courses, references = [short, pairs[1][0]], [drive for _, drive in pairs]
    trials = draw_trials(load_randomization("full"), model, 6, count=4, ticks=320)
    engine, vectors = Evaluator(TRACKER, courses, model, trials, references), candidates(12, 6, TRACKER)
    found = engine.outcomes(vectors)
    engine.change_trials(trials, first_course=1)
    assert np.array_equal(
        engine.outcomes(vectors).total[:, :1],
        Evaluator(TRACKER, courses[1:], model, trials, references[1:]).outcomes(vectors).total[:, :1],
    )
    engine.change_trials(trials)
    for j in range(4):
        course, drive = courses[j % 2], references[j % 2]
        policy = TRACKER.with_parameters(vectors[3])
        run = rollout(policy, course, model, trials=trials, row=j, reference=drive)
        assert found.total[3, j] == run.total
        assert found.error_m[3, j] == pytest.approx(run.verdict.error_m, abs=1e-12)
    assert np.array_equal(engine.outcomes(vectors[5:7]).total, found.total[5:7])
    # Others, with longer delays than lanes had room for before, and back.
    slow = default_rover(delay_v_s=0.9)
    engine.change_trials(draw_trials(load_randomization("none"), slow, 0, count=2, ticks=320))
    assert not np.array_equal(engine.outcomes(vectors).total, found.total[:, :2])
    engine.change_trials(trials)
    assert np.array_equal(engine.outcomes(vectors).total, found.total)


@pytest.mark.long
@settings(max_examples=100)
@given(
    seed=st.integers(0, 10**6),
    level=st.sampled_from(["none", "mild", "full", "skid"]),
    policy=st.sampled_from([POLICY, TRACKER]),
    fenced=st.booleans(),
)
def test_any_policy_on_any_course_in_any_trial_ends_as_a_rover_alone_does(seed, level, policy, fenced):
    course, reference = random_course(seed, 0)
    if fenced:
        course = course.model_copy(update={"obstacles": FENCED.obstacles})
    model = default_rover()
    trials = draw_trials(load_randomization(level), model, seed, count=3, ticks=course.ticks)
    try:
        evaluator = Evaluator(policy, course, model, trials, [reference])
    except ConfigError:
        assume(False)
    rng = np.random.default_rng(seed)
    vectors = in_bounds(policy, rng.random((2, policy.layout().size)))
    found = evaluator.outcomes(vectors)
    for i, vector in enumerate(vectors):
        for row in range(trials.size):
            drive = {"trials": trials, "row": row, "reference": reference}
            run = rollout(policy.with_parameters(vector), course, model, **drive)
            assert (found.total[i, row], found.touched[i, row]) == (run.total, run.touched)


@pytest.mark.parametrize("build", [Evaluator, rollout])
def test_a_policy_that_cannot_drive_is_rejected(build):
    with pytest.raises(ConfigError, match=r"no neuron 'LFT'"):
        build(parking_policy(load_circuit("tap_withdrawal")), COURSE)
