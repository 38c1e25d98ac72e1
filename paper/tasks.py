"""The paper's tasks (``tasks.yaml``) and the agents that are compared on them.

circuit    the tap-withdrawal circuit, untuned
random     a random wiring of its size, another one for each seed
mlp, lstm  networks of the published code: 12 cells (the paper: eleven), raw inputs, outputs clipped at ±1
ppo, a2c   a network trained by gradients (``gradients.py``)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rover_ncp.circuit.circuit import DEFAULTS, Circuit, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.sensing import Sensing
from rover_ncp.core.config import StrictModel, load_yaml
from sim.learn.search.published import KindRule

Vector = NDArray[np.float64]
PLANTS = ("mountain-car", "cart-pole", "written-pendulum", "pendulum", "half-cheetah")
"""In the order of ``native.c``."""
GRADIENTS = ("ppo", "a2c")
"""Agents of which only an actor is kept; only torch can train them."""
NETWORKS = ("mlp", "lstm")
PAPERS = ("circuit", "random", *NETWORKS)
AGENTS = (*PAPERS, *GRADIENTS)
SENSORY = ("PVD", "PLM", "AVM", "ALM")
"""Touch sensors: no synapse leads to them, here as in the tap-withdrawal circuit."""


def rng_of(seed: int, key: Sequence[int]) -> np.random.Generator:
    """Return the random numbers of a stream of a seed."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=tuple(key))))


def draw_seeds(root: int, key: Sequence[int], count: int) -> NDArray[np.uint64]:
    """Return the seeds (count,) of a stream."""
    sequence = np.random.SeedSequence(root, spawn_key=tuple(key))
    return sequence.generate_state(count, np.uint64).astype(np.uint64, copy=False)


_STARTS: Mapping[str, Callable[[np.random.Generator], Vector]] = {
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


class Training(NamedTuple):
    """Steps in all, environments side by side, and options that differ from the library's defaults."""

    steps: int
    environments: int
    options: dict[str, Any]


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
    """A name of ``STRATEGIES`` (``search.py``)."""
    rules: dict[ParameterKind, KindRule] = Field(default_factory=dict)
    """Rules of that search which are not parking's."""
    warm_up: int = 0
    """Ticks of a circuit before the first step of an episode, in the task's published code."""
    distance_of: int | None = None
    """Parking is rewarded by minus the distance from a checkpoint in so many of x, y and heading, as the
    paper's text has it. None: minus its square in all three, as the published code and all results have it.
    """

    def circuit(self) -> Circuit:
        """Return the untuned circuit."""
        return load_circuit(self.wiring)

    def policy(self, circuit: Circuit | None = None) -> Policy:
        """Put the task's sensing and motors around a circuit, the untuned one unless it is given."""
        return parking_policy(circuit or self.circuit())


class Benchmark(Task):
    """One of Gymnasium's tasks, run in lanes."""

    environment: str
    search_plant: str | None = None
    """A faster plant for the search; reported results are those of the task's own."""
    sensing: Sensing
    motors: Motors
    gradients: dict[str, Training] = Field(default_factory=dict)
    """Trainings of PPO and A2C."""
    bonus: float = 0.0
    """Added to every rewarded step, times 1 - |x| of the cart."""
    most: float = math.inf
    """Upper bound of a return, with bonus."""
    published_search: str = "published-benchmarks"
    warm_up: int = 1

    def policy(self, circuit: Circuit | None = None) -> Policy:
        """Put the task's sensing and motors around a circuit, with layers of zeros where it has layers."""
        circuit, sensing, motors = circuit or self.circuit(), self.sensing, self.motors
        if sensing.ranges is None:
            return Policy(circuit, sensing, motors)
        into, out_of = np.zeros((2, len(sensing.inputs))), np.zeros((len(motors.outputs), 2))
        return Policy(circuit, sensing, motors, input_layer=into, output_layer=out_of)

    @property
    def mujoco(self) -> bool:
        """Whether its environment is one of MuJoCo's."""
        return self.name in ("pendulum", "half-cheetah")

    def start(self, rng: np.random.Generator) -> Vector:
        """Draw the first state as the environment's reset does."""
        return _STARTS[self.name](rng)


class Cell(StrictModel):
    """Runs of the grid: each agent on each task, with so many seeds."""

    budget: str
    tasks: tuple[str, ...]
    agents: tuple[str, ...]
    seeds: int
    pairs: bool = False
    """With each pair of alpha and first sigma of Algorithm 1."""


class _File(StrictModel):
    benchmarks: tuple[Benchmark, ...]
    parking: tuple[Task, ...]
    grid: tuple[Cell, ...]


_FILE = load_yaml(Path(__file__).with_suffix(".yaml"), _File)
TASKS: Mapping[str, Task] = {task.name: task for task in (*_FILE.benchmarks, *_FILE.parking)}
GRID = _FILE.grid


@dataclass(frozen=True)
class Net:
    """A network of the published code in place of a circuit.

    Its parameters (P,): for each sum the weights of all inputs, in an LSTM those of all cells, and a bias;
    then for each output the weights of all cells and a bias.
    """

    kind: str
    inputs: int
    outputs: int
    cells: int = 12

    @property
    def gates(self) -> int:
        """Sums that a cell makes of its inputs."""
        return 1 if self.kind == "mlp" else 4

    @property
    def sizes(self) -> tuple[int, int]:
        """How many parameters the cells have, and the outputs after them."""
        recurrent = 0 if self.kind == "mlp" else self.cells
        return self.gates * self.cells * (self.inputs + recurrent + 1), self.outputs * (self.cells + 1)


def build_agent(task: Task, agent: str, seed: int) -> Policy | Net:
    """Return an untuned agent that a search can train."""
    policy, own = task.policy(), task.circuit()
    if agent in NETWORKS:
        return Net(agent, len(policy.sensing.inputs), len(policy.motors.outputs))
    return policy if agent == "circuit" else task.policy(random_circuit(seed, own.neurons, own.synapse_count))


def random_circuit(seed: int, neurons: Sequence[str], synapses: int) -> Circuit:
    """Return the random circuit of a seed, with exactly so many different synapses.

    As in the supplement: synapses of random kind, from any neuron to any but a sensory one, with weights
    uniform in 0..2 S and all else at its default. The published generator drops a synapse that it has drawn
    before, and so ends with 23 to 28; this one draws another.
    """
    targets = [number for number, name in enumerate(neurons) if name not in SENSORY]
    generator = rng_of(seed, ())
    rows: dict[tuple[SynapseKind, int, int], float] = {}
    while len(rows) < synapses:
        kind = SynapseKind(int(generator.integers(len(SynapseKind))))
        source = int(generator.integers(len(neurons)))
        target = targets[int(generator.integers(len(targets)))]
        weight = float(generator.uniform(0.0, 2.0))
        rows.setdefault((kind, source, target), weight)
    kinds, origins, destinations = np.array(list(rows)).T
    weights, sigmas = np.array(list(rows.values())), np.full(synapses, DEFAULTS[ParameterKind.SIGMA])
    potential, leak, capacitance = (
        np.full(len(neurons), DEFAULTS[kind])
        for kind in (ParameterKind.LEAK_POTENTIAL, ParameterKind.LEAK, ParameterKind.CAPACITANCE)
    )
    wires = kinds, origins, destinations, weights, sigmas
    return Circuit(f"random-{seed}", tuple(neurons), *wires, potential, leak, capacitance)
