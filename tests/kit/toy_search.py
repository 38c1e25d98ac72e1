"""A toy objective in the parameters of the parking circuit, for searches."""

import numpy as np

from rover_ncp.circuit.compiled import dead_parameters
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from sim.learn.search import Scores, start_search

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
    """Residuals (n, C, 3): the distance of each parameter from the goal, as a fraction of its range."""
    residuals = np.zeros((len(vectors), CHECKPOINTS * 3))
    residuals[:, : LAYOUT.size] = (vectors - GOAL) / WIDTH
    return residuals.reshape(len(vectors), CHECKPOINTS, 3)


def returns(residuals):
    return -np.sum(residuals**2, axis=(1, 2))


class ToySearch:
    """A search on a toy objective, and the best that it has tried."""

    def __init__(self, name, seed=0):
        self._search = start_search(name, LAYOUT, DEFAULTS, np.random.default_rng(seed), INERT)
        self.batch = next(self._search)
        self.tried, self.value, self.best = 0, -np.inf, None

    def step(self, toy=sphere):
        """Evaluate what the search asks for; return these candidates (n, P)."""
        residuals = toy(self.batch.vectors)
        return self.tell(returns(residuals), residuals)

    def tell(self, values, residuals):
        """Hand over scores; return their candidates."""
        vectors = self.batch.vectors.copy()
        if values.max() > self.value:
            self.value, self.best = values.max(), vectors[values.argmax()]
        self.tried += len(vectors)
        self.batch = self._search.send(Scores(values, residuals))
        return vectors

    def advance(self, count, toy=sphere):
        """Evaluate at least so many candidates in all; return those of this call (n, P)."""
        asked = []
        while self.tried < count:
            asked.append(self.step(toy))
        return np.concatenate(asked)
