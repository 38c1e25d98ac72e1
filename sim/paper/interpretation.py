"""Interpretation of the trained circuits: Definition 1 and time constants.

Definition 1 leaves three choices open: whether vertical steps count (the supplement calls them independence),
whether the whole run counts or only the drive, and the threshold. A sign here is one that all choices give.
"""

from collections import Counter
from collections.abc import Iterable
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import load_course
from rover_ncp.neurons.interpretation import STILL_MV, Sign, sign_of, time_constant_ranges
from sim.learn.engine.rollout import Rollout, rollout
from sim.paper.agents import build_agent
from sim.paper.results import Result, ResultStore
from sim.paper.tasks import find_task

FloatArray = NDArray[np.float64]

THRESHOLDS = (1.0, 1.5, 2.0)
"""One count must exceed the other by this factor; the paper's words allow several readings."""
_MOVING = 1e-4
"""Distance in m, or turn in rad, in a tick of 0.1 s above which the rover drives."""


def best_circuit(store: ResultStore, task: str) -> Result | None:
    """Return the best run of the circuit by the published search."""
    return max(store.results(task, "circuit"), key=lambda result: (result.success, result.mean), default=None)


def trained(result: Result) -> Policy:
    """Return the policy of a run of a circuit."""
    agent = build_agent(find_task(result.name.task), result.name.agent, result.name.seed)
    assert isinstance(agent, Policy)
    return agent.with_parameters(result.parameters.array())


@lru_cache(maxsize=1)
def drives(store: ResultStore) -> tuple[tuple[Policy, Rollout], ...]:
    """Return the published search's parking circuits that succeed, the best first, each with its drive."""
    results = [result for result in store.results("parking", "circuit") if result.success]
    policies = [trained(result) for result in sorted(results, key=lambda result: -result.mean)]
    return tuple((policy, rollout(policy, load_course("parking"))) for policy in policies)


def counts(a: FloatArray, b: FloatArray, *, vertical: bool) -> tuple[int, int]:
    """Return P and Q of two rows of potential differences: slopes above and below 0.

    A vertical step (b changes, a does not) has the sign of b's change; without ``vertical`` it is left out.
    """
    a, b = (np.where(np.abs(each) <= STILL_MV, 0.0, each) for each in (a, b))
    slopes = np.where((a == 0.0) & vertical, b, a * b)
    return int(np.sum(slopes > 0.0)), int(np.sum(slopes < 0.0))


def readings(policy: Policy, drive: Rollout, source: str, destination: str) -> Counter[Sign]:
    """Return the signs that the twelve readings of Definition 1 give a pair of neurons."""
    steps = np.diff(drive.potentials, axis=0)
    a, b = (steps[:, policy.circuit.index(neuron)] for neuron in (source, destination))
    moved = np.abs(np.diff(drive.poses, axis=0))[1:].max(axis=1) > _MOVING
    found: Counter[Sign] = Counter()
    for part, vertical in product((moved, np.ones_like(moved)), (True, False)):
        positive, negative = counts(a[part], b[part], vertical=vertical)
        found.update(sign_of(positive, negative, threshold) for threshold in THRESHOLDS)
    return found


def clear_signs(found: Iterable[Counter[Sign]]) -> list[Sign]:
    """Return the sign of each circuit's ``readings`` where all of them give the same one."""
    signs = [next(iter(each)) for each in found if len(each) == 1]
    return [sign for sign in signs if sign is not Sign.NONE]


def time_constants(store: ResultStore) -> dict[str, tuple[float, float]]:
    """Return the time constants in s of the best parking circuit over its drive, by neuron."""
    result = best_circuit(store, "parking")
    if result is None:
        return {}
    policy = trained(result)
    potentials = rollout(policy, load_course("parking")).potentials
    ranges = time_constant_ranges(policy.circuit, potentials, policy.sensing.neurons)
    return {each.neuron: (each.lowest_s, each.highest_s) for each in ranges}
