"""The example that holds the whole idea in one file computes what the project computes."""

from runpy import run_path

import numpy as np
from kit.paths import ROOT

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.files import resolve
from rover_ncp.course.course import load_course
from sim.learn.rollout import rollout

EXAMPLE = run_path(str(ROOT / "docs" / "examples" / "one_file.py"))


def test_example_follows_the_simulator_with_a_shipped_policy():
    expected = rollout(load_policy("parking"), load_course("parking"))
    run = EXAMPLE["drive"](EXAMPLE["load"](str(resolve("policies", "parking"))))
    np.testing.assert_allclose(run.potentials, expected.potentials, rtol=0, atol=0.002)
    np.testing.assert_allclose(run.poses, expected.poses, rtol=0, atol=1e-4)
    assert abs(run.total - expected.total) < 1e-4


def test_search_of_the_example_only_improves_and_stays_within_bounds():
    circuit, returns = EXAMPLE["search"](iterations=4, seed=3)
    assert len(returns) == 5
    assert returns == sorted(returns)
    assert returns[-1] > returns[0]
    assert EXAMPLE["drive"](circuit).total == returns[-1]
    for name, (lower, upper, _, count) in EXAMPLE["PARAMETERS"].items():
        assert circuit[name].shape == (count,)
        assert np.all((circuit[name] >= lower) & (circuit[name] <= upper))
