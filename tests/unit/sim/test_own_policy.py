"""Policies of a user behind the judge: the trials of a circuit, plain and in the stack, and clear errors."""

import re

import numpy as np
import pytest
from kit.paths import DATA, ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.cli import run
from rover_ncp.course.course import load_course
from sim.evaluate.evaluate import drive_trials, evaluate
from sim.learn.policies import any_policy
from sim.stack.trials import Stack
from sim.world.random_course import mirrored
from sim.world.randomization import load_randomization

SHORT = str(DATA / "short_course.yaml")
MODULE = """
class Rest:
    def __call__(self, observation):
        assert observation.shape == (4,)
        return 0.0, 0.0

class Blind(Rest):
    signals = ("x", "depth")

def short(observation):
    return (0.1,)

def fails(observation):
    return 1 / 0, 0.0

"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_module.py").write_text(MODULE)
    (tmp_path / "broken_module.py").write_text("import no_such_library\n")


class Circuit:
    """The shipped circuit as a function."""

    def __init__(self):
        self.signals = load_policy("course").sensing.inputs
        self.resets = 0

    def reset(self):
        self.resets += 1
        self.runner, self.warm = Runner(load_policy("course")), False

    def __call__(self, observation):
        if not self.warm:  # its observation does not have the start signal
            self.runner.tick(observation)
            self.warm = True
        return self.runner.tick(observation)


def test_a_function_is_judged_on_the_trials_of_a_circuit():
    own, arc, full = Circuit(), load_course(DATA / "arc_course.yaml"), load_randomization("full")
    courses = [arc, mirrored(arc)]
    given = {"courses": courses, "ranges": full, "trials": 3, "seed": 5}
    found = drive_trials(any_policy(own), **given)
    for one, other in zip(found, drive_trials(any_policy("course"), **given), strict=True):
        assert one == pytest.approx(other)
    assert own.resets == 3
    assert evaluate(own, courses[0], trials=1, randomize="full", seed=5).success_rate == 1.0


def test_a_function_drives_through_the_stack_as_a_circuit():
    own, course, full = Circuit(), load_course(SHORT), load_randomization("full")
    circuit = Stack(any_policy("course"), (course,), full, 5)
    errors_m = [circuit.drive(number).error_m for number in range(2)]
    found = evaluate(own, course, trials=2, randomize="full", seed=5, stack=True)
    assert own.resets == 2
    assert (found.error_m.max, found.error_m.p50) == pytest.approx((max(errors_m), np.mean(errors_m)))


def test_a_command_that_needs_a_circuit_says_so_of_a_policy_in_python(capsys):
    assert run(["export", "own_module:Follow", "--to", "c", "--out", "c"]) == 2
    assert "a policy in Python, expected one of a circuit" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        ("own_module:short", "expected v and omega as two finite numbers, got (0.1,)"),
        ("own_module:fails", "ZeroDivisionError: division by zero (own_module.py, line"),
        ("own_module:Blind", "policy own_module:Blind: unknown signals: depth (expected some of x, y"),
        ("broken_module:Follow", "No module named 'no_such_library'"),
    ],
)
def test_a_policy_that_cannot_drive_is_one_clear_line(policy, words, capsys):
    assert run(["eval", policy, "--course", SHORT, "--trials", "1"]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


def test_the_command_of_the_page_parks_with_the_classical_law(monkeypatch, run_json):
    page = (ROOT / "docs" / "sim_to_real.md").read_text()
    [command] = re.findall(r"rover-ncp (eval docs\.examples\.kanayama.*) --trials \d+", page)
    monkeypatch.chdir(ROOT)
    code, fields = run_json(f"{command} --trials 2")
    assert (code, fields["trials"], fields["success_rate"]) == (0, 2, 1.0)
