"""``rover-ncp eval`` through the real command line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from kit.paths import DATA

from rover_ncp.circuit.policy import course_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit, save_policy
from rover_ncp.cli import run
from rover_ncp.course.course import load_course
from rover_ncp.course.reference import plan_reference
from sim.learn.rollout import rollout
from sim.world.described import default_rover
from sim.world.randomization import draw_trials, load_randomization

ARC = str(DATA / "arc_course.yaml")
STAY = """\
format: 1
name: stay
start_signal_s: 1.0
horizon_s: 3.0
checkpoints:
  - {t: 0.5, x: 0.03, y: 0.04, theta: 0.0}
  - {t: 3.0, x: 0.0, y: 0.0, theta: 0.05}
"""


def numb():
    """A circuit without synapses, which does not move."""
    circuit = load_circuit("parking")
    return replace(circuit, weight=np.zeros(circuit.synapse_count))


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_policy(Path("untuned.yaml"), parking_policy(load_circuit("parking"), clamp=False))
    save_policy(Path("numb.yaml"), parking_policy(numb(), clamp=False))
    Path("stay.yaml").write_text(STAY)
    return tmp_path


def test_scores_a_published_circuit_with_sensors_that_are_not_clamped(files, run_json):
    code, fields = run_json("eval untuned.yaml")
    expected = rollout(parking_policy(load_circuit("parking"), clamp=False), load_course("parking"))
    assert (code, fields["trials"], fields["success_rate"]) == (1, 1, 0.0)
    assert fields["failures"] == {"too far from the goal": 1}
    assert fields["error_m"]["max"] == pytest.approx(expected.verdict.error_m)
    assert fields["mean_return"] == pytest.approx(expected.total)
    assert fields["mean_return"] == pytest.approx(-47.06, abs=0.02)  # by the published simulator


def test_a_policy_that_parks_ends_with_0(files, run_json, capsys):
    code, fields = run_json("eval numb.yaml --course stay.yaml")
    assert (code, fields["success_rate"]) == (0, 1.0)
    assert fields["mean_return"] == pytest.approx(-(0.03**2 + 0.04**2 + 0.05**2))
    assert (fields["error_m"]["max"], fields["error_rad"]["max"]) == (0.0, pytest.approx(0.05))
    assert run(["eval", "numb.yaml", "--course", "stay.yaml"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out == ["parked; return -0.0050", "final position error: 0 mm", "final heading error: 50 mrad"]


def test_trials_are_counted_as_each_alone_is_judged(files, run_json):
    policy = course_policy(load_circuit("tracking"))
    save_policy(Path("tracker.yaml"), policy)
    code, fields = run_json(f"eval tracker.yaml --course {ARC} --trials 12 --seed 4 --randomize harsh")
    model, course = default_rover(), load_course(ARC)
    trials = draw_trials(load_randomization("harsh"), model, 4, count=12, ticks=course.ticks)
    reference = plan_reference(course)
    verdicts = [
        rollout(policy, course, model, trials=trials, row=i, reference=reference).verdict for i in range(12)
    ]
    parked = sum(verdict.parked for verdict in verdicts)
    errors = [verdict.error_m for verdict in verdicts]
    assert 0 < parked < 12
    assert (code, fields["trials"], fields["success_rate"]) == (0, 12, parked / 12)
    assert sum(fields["failures"].values()) == 12 - parked
    assert fields["error_m"] == pytest.approx(
        {"p50": np.median(errors), "p95": np.percentile(errors, 95), "max": max(errors)}
    )
    assert fields["success_ci95"][0] < parked / 12 < fields["success_ci95"][1]


def test_only_a_single_trial_that_fails_ends_with_1(files, capsys):
    arguments = ["eval", "numb.yaml", "--randomize", "mild", "--trials"]
    assert run([*arguments, "1"]) == 1
    assert run([*arguments, "3"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("not parked: ")
    assert "\n0.0% of 3" in out


SAME = "are the same; add --randomize full"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--course stay.yaml --course parking --trials 1", "at least one trial for each of the 2 courses"),
        ("--trials 2", f"--trials 2: with the randomization none all trials of a course {SAME}"),
        ("--trials 2 --stack --body mujoco", "are the same; add --randomize varied"),
    ],
)
def test_number_of_trials_that_gives_no_sample_is_an_error(files, capsys, options, message):
    assert run(["eval", "numb.yaml", *options.split()]) == 2
    assert message in capsys.readouterr().err
