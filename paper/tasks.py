"""The paper's tasks (``tasks.yaml``): environment, mappings, settings, and success."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.sensing import Sensing
from rover_ncp.core.config import StrictModel, load_yaml
from rover_ncp.core.errors import UsageError

FloatArray = NDArray[np.float64]
Plant = Literal["mountain-car", "cart-pole", "written-pendulum", "pendulum", "half-cheetah"]

_STARTS: Mapping[str, Callable[[np.random.Generator], FloatArray]] = {
    "pendulum": lambda rng: rng.uniform(-0.01, 0.01, 4),
    "mountain-car": lambda rng: np.array([rng.uniform(-0.6, -0.4), 0.0]),
    "half-cheetah": lambda rng: np.concatenate([rng.uniform(-0.1, 0.1, 9), 0.1 * rng.standard_normal(9)]),
    "cart-pole": lambda rng: rng.uniform(-0.05, 0.05, 4),
}


class Settings(NamedTuple):
    """The paper's search: candidates, rollouts of each, and how many worst ones are averaged."""

    iterations: int
    rollouts: int
    worst: int


class MujocoModel(NamedTuple):
    """One of Gymnasium's model files, its step, and how many steps make one of the environment."""

    file: str
    step_s: float
    frames: int


class Task(StrictModel):
    """One row of the paper's tables."""

    name: str
    title: str
    settings: Settings
    horizon: int
    success: float
    """A run succeeds when its mean return, without bonus, is at least this."""
    threshold_from: str = "ours"
    """Origin of ``success``; the paper states no threshold."""
    margin: float
    """Difference of returns that counts as none."""
    wiring: str = "tap_withdrawal"
    """Name of the tap-withdrawal circuit with the task's motor neurons."""
    published_search: str = "published-parking"
    """A name of ``SEARCHES`` (``search/published.py``)."""
    warm_up: int = 0
    """Ticks of a circuit before the first step of an episode, in the task's published code."""

    def circuit(self) -> Circuit:
        """Return the untuned circuit."""
        return load_circuit(self.wiring)

    def policy(self, circuit: Circuit) -> Policy:
        """Put the task's sensing and motors around a circuit."""
        return parking_policy(circuit)


class Benchmark(Task):
    """One of Gymnasium's tasks, run in lanes."""

    environment: str
    plant: Plant
    search_plant: Plant | None = None
    """A faster plant for the search; reported results are those of ``plant``."""
    model: MujocoModel | None = None
    sensing: Sensing
    motors: Motors
    bonus: float = 0.0
    """Added to every rewarded step, times 1 - |x| of the cart."""
    most: float = math.inf
    """Upper bound of a return, with bonus."""
    published_search: str = "published-benchmarks"
    warm_up: int = 1

    def policy(self, circuit: Circuit) -> Policy:
        """Put the task's sensing and motors around a circuit, with layers of zeros where it has layers."""
        sensing, motors = self.sensing, self.motors
        if sensing.ranges is None:
            return Policy(circuit, sensing, motors)
        into, out_of = np.zeros((2, len(sensing.inputs))), np.zeros((len(motors.outputs), 2))
        return Policy(circuit, sensing, motors, input_layer=into, output_layer=out_of)

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Draw the first state as the environment's reset does."""
        return _STARTS[self.name](rng)


class _File(StrictModel):
    benchmarks: tuple[Benchmark, ...]
    parking: tuple[Task, ...]


_FILE = load_yaml(Path(__file__).with_suffix(".yaml"), _File)
TASKS: Mapping[str, Task] = {task.name: task for task in (*_FILE.benchmarks, *_FILE.parking)}


def find_task(name: str) -> Task:
    """Return a task by its name; raises UsageError, which lists all names."""
    if name not in TASKS:
        raise UsageError(f"no task {name!r}; there are {', '.join(TASKS)}")
    return TASKS[name]
