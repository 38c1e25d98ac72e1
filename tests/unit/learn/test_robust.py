"""Training on random trials, and its command."""

import numpy as np
import pytest
import yaml

from rover_ncp.circuit.policy import course_policy
from rover_ncp.circuit.policy_file import load_circuit, load_policy
from rover_ncp.cli import run
from rover_ncp.course.course import load_course
from rover_ncp.course.reference import plan_reference
from sim.learn.evaluator import Evaluator, Outcomes
from sim.learn.robust import (
    RobustSearch,
    costs,
    drive_trials,
    policy_box,
    training_courses,
)
from sim.world.described import default_rover
from sim.world.random_course import random_course
from sim.world.randomization import draw_trials, load_randomization

COURSE, MODEL = load_course("parking"), default_rover()
START = course_policy(load_circuit("tracking"))
FULL = load_randomization("full")


def engine():
    trials = draw_trials(FULL, MODEL, 0, count=1, ticks=COURSE.ticks)
    return Evaluator(START, COURSE, MODEL, trials)


def search(generations, seed=3):
    """Return the winner of each generation of a search."""
    going = RobustSearch(policy_box(START), seed=seed, rollouts=128, worst=128)
    drive, winners = drive_trials(engine(), FULL, MODEL, seed), []
    for _ in range(generations):
        going.advance(drive)
        winners.append(going.winner)
    return winners


def outcome(**changes):
    fields = dict.fromkeys(Outcomes._fields, np.zeros((1, 1)))
    return Outcomes(**fields | {name: np.array([[value]]) for name, value in changes.items()})


@pytest.mark.parametrize(
    ("field", "good", "bad"),
    [
        ("error_m", 0.05, 0.12),
        ("turned_rad", 0.002, 0.005),
    ],
)
def test_a_cost_rises_with_each_error_and_most_before_parked_ends(field, good, bad):
    perfect = costs(outcome())[0, 0]
    near, far, farthest = (costs(outcome(**{field: value}))[0, 0] for value in (good, bad, 20 * bad))
    assert perfect < near < far < farthest
    assert far - near > 4
    assert farthest - far < 6


def test_training_and_evaluation_share_no_course():
    given = plan_reference(COURSE)
    courses, references = training_courses(COURSE, given, 0, 24)
    assert len(courses) == len(references) == 36
    assert sum(course is COURSE for course in courses) == 6
    seen = {course.checkpoints for course in courses}
    assert len(seen) == 26
    assert courses[3].goal == (COURSE.goal.x, -COURSE.goal.y, -COURSE.goal.theta)
    assert references[3].tick(320)[0].y == pytest.approx(courses[3].goal.y, abs=1e-3)
    assert not seen & {random_course(0, number)[0].checkpoints for number in range(24)}
    assert training_courses(COURSE, given, 0, 0) == ([COURSE], [given])


def test_the_search_improves_and_repeats_itself():
    first = search(8)
    assert all(np.array_equal(a, b) for a, b in zip(first, search(3), strict=False))
    [other] = search(1, seed=4)
    assert not np.array_equal(other, first[0])
    judge = engine()
    judge.change_trials(draw_trials(FULL, MODEL, 9, count=60, ticks=COURSE.ticks))
    before, after = costs(judge.outcomes([START.parameters(), first[-1]])).mean(axis=1)
    assert after < before


@pytest.mark.long
def test_the_command_leaves_a_policy_that_says_how_it_was_made(tmp_path, monkeypatch, run_json):
    monkeypatch.chdir(tmp_path)
    options = "--randomize mild --iterations 2 --rollouts 4 --random-courses 2 --seed 5"
    code, fields = run_json(f"train {options} --out mine")
    assert code == 0
    assert (fields["generations"], fields["randomize"], fields["worst"]) == (2, "mild", 4)
    policy = load_policy("mine/policy.yaml")
    assert policy.sensing.name == "course"
    assert policy.courses == ("parking", "random")
    assert (tmp_path / "mine/curve.csv").read_text().count("\n") == 3
    assert yaml.safe_load((tmp_path / "mine/settings.yaml").read_text())["settings"]["seed"] == 5
    command = policy.provenance["command"].split()
    assert command[:2] == ["rover-ncp", "train"]
    assert run([*command[1:], "--out", "again"]) == 0
    assert np.array_equal(load_policy("again/policy.yaml").parameters(), policy.parameters())
