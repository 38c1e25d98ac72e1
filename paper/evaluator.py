"""Whole episodes of a benchmark in one kernel: each lane has a controller and a plant.

Episodes wait in a queue for a free lane. The result of an episode depends neither on its lane nor on the
other episodes.
"""

from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from paper.networks import Net, network_lane_runner
from paper.plants import KINDS, NO_MUJOCO, Plants, observe, reset_plant, step_plant
from paper.tasks import Benchmark
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.kernels.jit import kernel
from rover_ncp.kernels.vectors import WIDTH
from sim.learn.engine.lane_runner import circuit_lane_runner
from sim.learn.engine.lanes import IDLE
from sim.learn.search.base import Seeds

FloatArray = NDArray[np.float64]


class Play(NamedTuple):
    """One episode of T steps."""

    outputs: FloatArray
    """(T, outputs)."""
    potentials: FloatArray
    """(T, n) mV, after each tick."""
    rewards: FloatArray
    """(T,)."""


_LANES, _MUJOCO_LANES = WIDTH, 16
"""The kernel computes all lanes while one of them has an episode: fewer lanes, fewer idle ones."""
_LOST = -1e6
"""Return of an episode whose simulation became unstable."""


class Episodes(NamedTuple):
    """E episodes: their parameter vectors (E, P), first states (E, S), and the steps after which they end."""

    vectors: FloatArray
    starts: FloatArray
    horizon: int
    warm_up: int
    """Ticks on the first observation, whose commands are ignored, before the first step."""


@cache
def episode_kernel(start_lane: Any, tick_lanes: Any) -> Any:
    """Return the kernel that runs episodes with a runner's two kernels."""

    @kernel
    def run_episodes(arrays: Any, plants: Plants, shape: tuple[int, int], queue: Episodes) -> FloatArray:
        """Return (E, 3): Gymnasium's return, the sum of bonuses, and steps.

        ``shape`` holds the numbers of a controller's inputs and outputs.
        """
        count = plants.state.shape[1]
        observations, commands = np.zeros((shape[0], count)), np.zeros((shape[1], count))
        episodes, ticks = np.full(count, IDLE), np.zeros(count, np.int64)
        results = np.zeros((len(queue.vectors), 3))
        waiting, running = 0, 0
        while True:
            for lane in range(count):
                if episodes[lane] == IDLE and waiting < len(results):
                    start_lane(arrays, lane, queue.vectors[waiting])
                    reset_plant(plants, lane, queue.starts[waiting])
                    episodes[lane], ticks[lane] = waiting, -queue.warm_up
                    waiting += 1
                    running += 1
                if episodes[lane] != IDLE:
                    observe(plants, lane, observations)
            if running == 0:
                return results
            tick_lanes(arrays, observations, commands)
            for lane in range(count):
                episode = episodes[lane]
                if episode == IDLE:
                    continue
                ticks[lane] += 1
                if ticks[lane] <= 0:
                    continue
                reward, bonus, terminated = step_plant(plants, lane, commands)
                results[episode, 0] += reward
                results[episode, 1] += bonus
                results[episode, 2] = ticks[lane]
                if terminated or ticks[lane] == queue.horizon:
                    episodes[lane] = IDLE
                    running -= 1

    return run_episodes


def make_plants(task: Benchmark, *, for_search: bool = False) -> tuple[Plants, Any]:
    """Return plants, and the owner of their memory in MuJoCo, to be kept alive beside them.

    ``for_search`` takes the task's faster plant where it has one.
    """
    plant = task.search_plant if for_search and task.search_plant is not None else task.plant
    count, pool = _LANES, None
    if task.model is not None and plant == task.plant:
        from paper.mujoco_pool import MujocoPool  # an extra that the other tasks do without

        count = _MUJOCO_LANES
        pool = MujocoPool(task.model.file, task.model.step_s, count)
    plants = Plants(
        kind=KINDS[plant],
        bonus=task.bonus,
        step_s=task.model.step_s if task.model else 0.0,
        frames=task.model.frames if task.model else 1,
        state=np.zeros((len(task.start(np.random.default_rng(0))), count)),
        fresh=np.zeros(count, np.bool_),
        mujoco=pool.lanes if pool else NO_MUJOCO,
    )
    return plants, pool


class Evaluator:
    """Scores parameter vectors of one agent by episodes of a benchmark. One thread at a time."""

    def __init__(
        self, task: Benchmark, agent: Policy | Net, *, for_search: bool = False, warm_up: int | None = None
    ) -> None:
        """``warm_up`` is the task's for a circuit and 0 for a network unless it is given."""
        self.task, self.agent, self.steps = task, agent, 0
        own = task.warm_up if isinstance(agent, Policy) else 0
        self._warm_up = own if warm_up is None else warm_up
        self.enough = task.success
        self._plants, self._pool = make_plants(task, for_search=for_search)
        if isinstance(agent, Policy):
            runner = circuit_lane_runner(agent)
            self._shape = len(agent.sensing.inputs), len(agent.motors.outputs)
        else:
            runner, self._shape = network_lane_runner(agent), (len(agent.scale), len(agent.high))
        self._arrays = runner.allocate(self._plants.state.shape[1])
        self._kernel = episode_kernel(runner.start_lane, runner.tick_lanes)

    def of(self, agent: Policy) -> Self:
        """Return the same episodes for another agent with the task's inputs and outputs."""
        return type(self)(self.task, agent, warm_up=self._warm_up)

    def starts(self, seeds: Seeds) -> FloatArray:
        """Return the first states (n, S) that the environment's ``reset(seed)`` gives for seeds (n,)."""
        generators = (np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(s)))) for s in seeds)
        return np.array([self.task.start(generator) for generator in generators])

    def run(self, vectors: ArrayLike, seeds: Seeds) -> FloatArray:
        """Run one episode for each vector (n, P) and seed (n,).

        Returns (n, 3): Gymnasium's return, the sum of bonuses, and steps, which ``self.steps`` counts. An
        unstable simulation returns -1e6.
        """
        rows = np.ascontiguousarray(vectors, np.float64)
        queue = Episodes(rows, self.starts(seeds), self.task.horizon, self._warm_up)
        results: FloatArray = self._kernel(self._arrays, self._plants, self._shape, queue)
        self.steps += int(results[:, 2].sum())
        results[~np.isfinite(results[:, :2].sum(axis=1)), :2] = (_LOST, 0.0)
        return results

    def returns(self, vectors: FloatArray, seeds: Seeds) -> FloatArray:
        """Return the returns with bonus (n, k) of vectors (n, P), each in the episodes of seeds (k,)."""
        found = self.run(np.repeat(vectors, len(seeds), axis=0), np.tile(seeds, len(vectors)))
        returns: FloatArray = found[:, :2].sum(axis=1).reshape(len(vectors), len(seeds))
        return returns

    def play(self, seed: int) -> Play:
        """Play one episode of the policy, with its own parameters."""
        assert isinstance(self.agent, Policy)
        runner, plants = Runner(self.agent), self._plants
        seen = np.zeros((self._shape[0], plants.state.shape[1]))
        reset_plant(plants, 0, self.starts(np.array([seed], np.uint64))[0])
        observe(plants, 0, seen)
        for _ in range(self._warm_up):
            runner.tick(seen[:, 0])
        rows: list[tuple[FloatArray, FloatArray, float]] = []
        terminated = False
        while not terminated and len(rows) < self.task.horizon:
            observe(plants, 0, seen)
            outputs = np.array(runner.tick(seen[:, 0]))
            reward, bonus, terminated = step_plant(plants, 0, outputs[:, None])
            rows.append((outputs, runner.potentials, reward + bonus))
        return Play(*(np.array(part) for part in zip(*rows, strict=True)))
