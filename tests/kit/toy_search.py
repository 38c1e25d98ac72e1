"""A toy objective in the parameters of the parking circuit, for searches."""

import numpy as np

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit

POLICY = parking_policy(load_circuit("parking"))
LAYOUT = POLICY.layout()
DEFAULTS = POLICY.parameters()
WIDTH = LAYOUT.upper - LAYOUT.lower
INERT = dead_parameters(POLICY)
GOAL = np.where(INERT, DEFAULTS, LAYOUT.lower + WIDTH * np.random.default_rng(99).random(LAYOUT.size))
CHECKPOINTS = -(-LAYOUT.size // 3)
SAMPLES = LAYOUT.lower + WIDTH * np.random.default_rng(5).random((2000, LAYOUT.size))


def candidates(count, seed=0, policy=POLICY):
    """Parameter vectors around those of a policy; most of the untuned one's drive, some in circles."""
    layout = policy.layout()
    noise = np.random.default_rng(seed).normal(size=(count, layout.size))
    return np.clip(
        policy.parameters() + 0.08 * noise * (layout.upper - layout.lower), layout.lower, layout.upper
    )


def sphere(vectors):
    """Residuals (n, 1, C, 3): the distance of each parameter from the goal, as a fraction of its range."""
    residuals = np.zeros((len(vectors), CHECKPOINTS * 3))
    residuals[:, : LAYOUT.size] = (vectors - GOAL) / WIDTH
    return residuals.reshape(len(vectors), 1, CHECKPOINTS, 3)


def returns(residuals):
    return -np.sum(residuals**2, axis=(1, 2, 3))


def advance(search, evaluations, toy=sphere, ahead=1000):
    """Evaluate so many candidates; return all that were asked for (n, P)."""
    asked = [np.empty((0, LAYOUT.size))]
    while search.evaluations < evaluations:
        asked.append(search.ask(min(evaluations - search.evaluations, ahead, search.max_ahead)))
        assert len(search.to_beat) == len(asked[-1])
        residuals = toy(asked[-1])
        search.tell(returns(residuals), residuals)
    return np.concatenate(asked)
