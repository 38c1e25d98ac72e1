"""What the native library is given: anything that it could not work on is an exception in Python."""

import numpy as np
import pytest
from kit.toy_search import POLICY

from rover_ncp.core.errors import UsageError
from rover_ncp.course.course import load_course
from rover_ncp.course.signals import SIGNALS
from rover_ncp.native import core
from sim.learn.evaluator import Evaluator

COURSE = load_course("parking")


def arrays(value, path=()):
    """Yield the path and the value of each array of a named tuple."""
    for name, part in zip(value._fields, value, strict=True):
        if hasattr(part, "_fields"):
            yield from arrays(part, (*path, name))
        elif isinstance(part, np.ndarray):
            yield (*path, name), part


def replaced(value, path, array):
    name, *rest = path
    return value._replace(**{name: replaced(getattr(value, name), rest, array) if rest else array})


@pytest.fixture
def everything():
    """All that episodes are run with."""
    evaluator = Evaluator(POLICY, COURSE)
    found = {}

    def keep(circuits, signal_at, **tuples):
        found.update(circuits=circuits, signal_at=signal_at, **tuples)
        return lambda: None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sim.learn.evaluator.bound_episodes", keep)
        evaluator.stream(2)
    yield found  # which the evaluator keeps alive


@pytest.mark.parametrize(
    ("name", "path", "index"),
    [
        ("queue", ("vector",), 10**6),
        ("queue", ("trial",), -1),
        ("lanes", ("latest",), 10**6),
        ("tasks", ("ticks",), 10**6),
        ("trials", ("delay",), 10**6),
        ("circuits", ("program", "sensors", "neuron"), 12),
        ("circuits", ("program", "recurrent_synapses", "source"), -1),
    ],
)
def test_no_index_points_elsewhere(name, path, index, everything):
    value = everything[name]
    array = dict(arrays(value))[path].copy()
    array.flat[-1] = index
    with pytest.raises(ValueError, match="points to"):
        core.bound_episodes(**everything | {name: replaced(value, path, array)})


def test_array_of_another_type_is_refused(everything):
    trials = everything["trials"]
    with pytest.raises((TypeError, ValueError)):
        core.bound_episodes(**everything | {"trials": trials._replace(start=trials.start.astype(np.float32))})


def test_the_library_has_the_signals_of_the_table():
    assert core.required().rover_ncp_signals() == len(SIGNALS)


def test_without_the_library_training_says_what_it_needs(monkeypatch):
    monkeypatch.setattr(core, "library", lambda: None)
    with pytest.raises(UsageError, match="native library, which was not built"):
        Evaluator(POLICY, COURSE).returns(POLICY.parameters())


def test_library_of_other_sources_is_refused_with_the_command_that_builds_it(tmp_path, monkeypatch):
    checkout = tmp_path / "rover_ncp" / "native"
    checkout.mkdir(parents=True)
    monkeypatch.setattr(core, "_SOURCES", checkout)
    with pytest.raises(UsageError, match="install rover-ncp again"):
        core.load()
    (tmp_path / "hatch_build.py").touch()
    with pytest.raises(UsageError, match=f"run python {tmp_path}/hatch_build.py"):
        core.load()
