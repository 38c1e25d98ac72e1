"""Episodes of a benchmark, played for an explanation: returns of many, and the potentials of one."""

from typing import Self

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.runner import Runner
from sim.learn.engine.environment import Play
from sim.learn.search.base import Seeds, Vector
from sim.paper.evaluator import Evaluator, make_plants
from sim.paper.plants.lanes import observe, reset_plant, step_plant
from sim.paper.tasks import Benchmark


class BenchmarkEpisodes:
    """Episodes of a benchmark with one policy, whose inputs and outputs are the task's."""

    def __init__(self, task: Benchmark, policy: Policy) -> None:
        self.task, self.policy = task, policy
        self.enough: float | None = task.success
        self._evaluator = Evaluator(task, policy)

    def of(self, policy: Policy) -> Self:
        """Return the episodes of another policy with the same inputs and outputs."""
        return type(self)(self.task, policy)

    def returns(self, vectors: Vector, seeds: Seeds) -> Vector:
        """Return the returns with bonus (n, k) of vectors (n, P), each in the episodes of seeds (k,)."""
        return self._evaluator.returns(vectors, seeds)

    def play(self, seed: int) -> Play:
        """Play one episode of the policy."""
        plants, pool = make_plants(self.task, 1)
        runner = Runner(self.policy)
        seen = np.zeros((len(self.policy.sensing.inputs), 1))
        reset_plant(plants, 0, self._evaluator.starts(np.array([seed], np.uint64))[0])
        rows: list[tuple[Vector, Vector, float]] = []
        terminated = False
        while not terminated and len(rows) < self.task.horizon:
            observe(plants, 0, seen)
            outputs = np.array(runner.tick(seen[:, 0]))
            reward, bonus, terminated = step_plant(plants, 0, outputs[:, None])
            rows.append((outputs, runner.potentials, reward + bonus))
        del pool  # owned the memory of MuJoCo's plants until here
        return Play(*(np.array(part) for part in zip(*rows, strict=True)))
