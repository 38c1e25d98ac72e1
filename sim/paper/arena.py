"""A benchmark's environment, ready to score parameter vectors of one agent by whole episodes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.kernels.vectors import WIDTH
from sim.learn.networks import Net
from sim.paper.brain import make_brain
from sim.paper.cheetah_model import NO_CHEETAH, load_cheetah
from sim.paper.episodes import IDLE, RESULTS, Queue, Room, run_episodes
from sim.paper.plants import WRITTEN_CHEETAH, allocate_plants
from sim.paper.tasks import Benchmark

FloatArray = NDArray[np.float64]
Seeds = NDArray[np.uint64]

_LANES, _MUJOCO_LANES = WIDTH, 16
"""All lanes are computed as long as one of them is at work: few stand idle where they are few."""


def draw_seeds(root: int, key: tuple[int, ...], count: int) -> Seeds:
    """Return the seeds (count,) of a stream."""
    sequence = np.random.SeedSequence(root, spawn_key=key)
    return sequence.generate_state(count, np.uint64).astype(np.uint64, copy=False)


class Arena:
    """Scores parameter vectors of one agent. One thread at a time.

    ``rough``, on the task's stand-in where it has one.
    """

    def __init__(
        self, task: Benchmark, agent: Policy | Net, lanes: int | None = None, *, rough: bool = False
    ) -> None:
        self.task, self.steps = task, 0
        stand_in = task.stand_in if rough else None
        mujoco = None if stand_in else task.mujoco
        count = lanes or (_MUJOCO_LANES if mujoco else _LANES)
        if isinstance(agent, Policy):
            inputs, outputs = len(agent.sensing.inputs), len(agent.motors.outputs)
        else:
            inputs, outputs = len(agent.scale), len(agent.high)
        self._brain = make_brain(agent, count)
        self._room = Room(
            np.zeros((inputs, count)),
            np.zeros((outputs, count)),
            np.full(count, IDLE),
            np.zeros(count, np.int64),
        )
        if stand_in:
            kind, step_s, frames = stand_in
            cheetah = NO_CHEETAH
            if kind == WRITTEN_CHEETAH:
                assert task.mujoco is not None
                cheetah = load_cheetah(task.mujoco.file)
            self._plants = allocate_plants(
                kind, count, task.bonus, step_s=step_s, frames=frames, cheetah=cheetah
            )
        elif mujoco is None:
            self._plants = allocate_plants(task.plant, count, task.bonus)
        else:
            from sim.paper.mujoco_plants import MujocoPool  # an extra that the other tasks do without

            self._pool = MujocoPool(mujoco.file, mujoco.frames, count, mujoco.step_s)
            self._plants = allocate_plants(task.plant, count, task.bonus, self._pool.lanes)

    def starts(self, seeds: Seeds) -> FloatArray:
        """Return the first states (n, S) that the environment's ``reset(seed)`` gives for seeds (n,)."""
        generators = (np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(s)))) for s in seeds)
        return np.array([self.task.start(generator) for generator in generators])

    def run(self, vectors: ArrayLike, seeds: Seeds, *, horizon: int | None = None) -> FloatArray:
        """Run one episode for each vector (n, P) and seed (n,); returns (n, 3), see ``RESULTS``.

        ``steps`` counts what the environments have done. The default horizon is the task's.
        """
        rows = np.ascontiguousarray(vectors, np.float64)
        results = np.zeros((len(rows), RESULTS))
        ticks = horizon or self.task.horizon
        queue = Queue(rows, np.arange(len(rows)), self.starts(seeds), ticks, results)
        run_episodes(self._brain, self._plants, self._room, queue)
        self.steps += int(results[:, 2].sum())
        return results
