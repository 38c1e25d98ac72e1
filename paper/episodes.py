"""Whole episodes of a benchmark, by circuits and networks, in a library that is compiled from ``native.c``.

The result of an episode depends neither on its lane nor on the others. Circuits tick in rover_ncp's library.
"""

import ctypes
import hashlib
import subprocess
import tempfile
from ctypes import c_bool, c_double, c_int64, c_void_p
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from paper.tasks import PLANTS, Benchmark, Net, Vector, rng_of
from rover_ncp.circuit.circuit import RESTING_MV
from rover_ncp.circuit.compiled import make_circuits
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import UsageError
from rover_ncp.native.core import bound_tick, required

LANES = 8
SOURCE = Path(__file__).with_name("native.c")
BUILD = Path(__file__).with_name("build")
COMPILE = ("cc", "-std=c11", "-O3", "-ffp-contract=off", "-shared", "-fPIC")
_LOST = -1e6
"""Return of an episode whose simulation became unstable."""


class _Mujoco(ctypes.Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("step", "reset", "forward", "model")),
        *((name, c_void_p * LANES) for name in ("data", "qpos", "qvel", "ctrl")),
    )


class Episodes(ctypes.Structure):
    """Lanes and queue of ``native.c``, where the fields are described."""

    _fields_ = (
        *((name, c_int64) for name in ("kind", "states", "inputs", "outputs", "frames")),
        *((name, c_double) for name in ("step_s", "bonus")),
        *((name, c_int64) for name in ("horizon", "warm_up", "count", "waiting", "running")),
        *((name, c_void_p) for name in ("starts", "results", "observations", "commands", "state")),
        *((name, c_int64 * LANES) for name in ("episode", "tick")),
        ("fresh", c_bool * LANES),
        ("mujoco", _Mujoco),
    )


@cache
def library() -> ctypes.CDLL:
    """Return the library of ``native.c``, compiled once for each content. Raises UsageError."""
    digest = hashlib.sha256(SOURCE.read_bytes() + repr(COMPILE).encode()).hexdigest()[:16]
    path = BUILD / f"native-{digest}.so"
    if not path.is_file():
        BUILD.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=BUILD) as folder:  # several processes may compile at once
            made = Path(folder) / path.name
            try:
                subprocess.run(
                    [*COMPILE, "-o", made, SOURCE, "-lm"], check=True, capture_output=True, text=True
                )
            except (OSError, subprocess.CalledProcessError) as error:
                why = getattr(error, "stderr", "") or error
                raise UsageError(f"{SOURCE}: needs a C compiler as cc, install gcc: {why}") from error
            made.replace(path)
    return ctypes.CDLL(str(path))


class MujocoPool:
    """One of Gymnasium's MuJoCo models, and data for each lane, stepped in C.

    From Python a step of the inverted pendulum costs more in calls than in physics.
    """

    def __init__(self, environment: str) -> None:
        import gymnasium
        import mujoco

        # Without a handler, MuJoCo writes warnings to a file, such as that of an outdated attribute in
        # Gymnasium's half-cheetah. Others report an unstable simulation, which shows in its return too.
        mujoco.set_mju_user_warning(lambda _: None)
        world: Any = gymnasium.make(environment, disable_env_checker=True).unwrapped
        self.model, self.frames = world.model, world.frame_skip
        # Or an unstable simulation would begin again at rest, and its return would look like any other.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = [mujoco.MjData(self.model) for _ in range(LANES)]
        [loaded] = Path(mujoco.__file__).parent.glob("libmujoco.*")
        functions = (
            getattr(ctypes.CDLL(str(loaded)), f"mj_{name}") for name in ("step", "resetData", "forward")
        )
        arrays = (
            [data._address for data in self.data],
            *([getattr(data, name).ctypes.data for data in self.data] for name in ("qpos", "qvel", "ctrl")),
        )
        self.addresses = _Mujoco(
            *(ctypes.cast(function, c_void_p) for function in functions),
            self.model._address,
            *((c_void_p * LANES)(*array) for array in arrays),
        )


class PlantEvaluator:
    """Scores parameter vectors of one agent by episodes of a benchmark. One thread at a time."""

    def __init__(
        self, task: Benchmark, agent: Policy | Net, *, for_search: bool = False, warm_up: int = 0
    ) -> None:
        """``for_search`` takes the task's faster plant where it has one."""
        self.task, self.agent, self.steps = task, agent, 0
        if isinstance(agent, Policy):
            inputs, outputs = len(agent.sensing.inputs), len(agent.motors.outputs)
            self._circuits = make_circuits(agent, LANES)
        else:
            inputs, outputs = agent.inputs, agent.outputs
            sizes = (sum(agent.sizes), agent.cells, agent.cells, agent.gates * agent.cells)
            self._work = [np.zeros((size, LANES)) for size in sizes]
        plant = (for_search and task.search_plant) or task.name
        pool = MujocoPool(task.environment) if task.mujoco else None
        self.pool = pool if plant == task.name else None
        states = len(task.start(rng_of(0, ())))
        self.state = np.zeros((LANES, states))
        self.observations, self.commands = np.zeros((inputs, LANES)), np.zeros((outputs, LANES))
        self.episodes = Episodes(
            kind=PLANTS.index(plant),
            states=states,
            inputs=inputs,
            outputs=outputs,
            frames=pool.frames if pool else 1,
            step_s=pool.model.opt.timestep if pool else 0.0,
            bonus=task.bonus,
            horizon=task.horizon,
            warm_up=warm_up,
            observations=self.observations.ctypes.data,
            commands=self.commands.ctypes.data,
            state=self.state.ctypes.data,
            episode=(c_int64 * LANES)(*[-1] * LANES),
        )
        if self.pool is not None:
            self.episodes.mujoco = self.pool.addresses

    def starts(self, seeds: NDArray[np.uint64]) -> Vector:
        """Return the first states (n, S) that the environment's ``reset(seed)`` gives for seeds (n,)."""
        return np.array([self.task.start(rng_of(int(seed), ())) for seed in seeds])

    def queue(self, starts: Vector) -> Vector:
        """Let episodes wait that begin in states (E, S); return the array (E, 3) of their results."""
        self.queued, self.results = np.ascontiguousarray(starts), np.zeros((len(starts), 3))
        self.episodes.starts, self.episodes.results = self.queued.ctypes.data, self.results.ctypes.data
        self.episodes.count, self.episodes.waiting = len(starts), 0
        return self.results

    def run(self, vectors: ArrayLike, seeds: NDArray[np.uint64]) -> Vector:
        """Run one episode for each vector (n, P) and seed (n,).

        Returns (n, 3): Gymnasium's return, the sum of bonuses, and steps, which ``self.steps`` counts. An
        unstable simulation returns -1e6.
        """
        rows = np.ascontiguousarray(vectors, np.float64)
        results = self.queue(self.starts(seeds))
        episodes, given = ctypes.byref(self.episodes), c_void_p(rows.ctypes.data)
        if isinstance(self.agent, Policy):
            core, tick = required(), bound_tick(self._circuits, self.observations, self.commands)
            functions = core.rover_ncp_fill_lanes, core.rover_ncp_tick_lanes
            sizes = c_int64(rows.shape[1]), c_int64(self.agent.circuit.size)
            potentials = c_void_p(self._circuits.potentials.ctypes.data)
            run = library().run_circuits
            run(episodes, *functions, *tick.args, *sizes, given, potentials, c_double(RESTING_MV))
        else:
            numbers = map(c_int64, (self.agent.gates, self.agent.cells, rows.shape[1]))
            work = (c_void_p(array.ctypes.data) for array in self._work)
            library().run_networks(episodes, *numbers, given, *work)
        self.steps += int(results[:, 2].sum())
        results[~np.isfinite(results[:, :2].sum(axis=1)), :2] = (_LOST, 0.0)
        return results
