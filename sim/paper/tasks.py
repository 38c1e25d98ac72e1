"""The paper's tasks: environment, mappings, settings, and success.

Mappings and settings: Hasani et al. (ICRA 2020), Tables S3, S4 and S6; half-cheetah's are those of the
published code. Thresholds are Gymnasium's where it has one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.sensing import Channel, Sensing
from rover_ncp.core.errors import UsageError
from sim.paper.plants.lanes import CART_POLE, HALF_CHEETAH, MOUNTAIN_CAR, PENDULUM, WRITTEN_PENDULUM

FloatArray = NDArray[np.float64]


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


@dataclass(frozen=True)
class Task:
    """One row of the paper's tables."""

    name: str
    title: str
    settings: Settings
    horizon: int
    success: float
    """A run succeeds when its mean return, without bonus, is at least this."""
    enough: float
    """A search may stop when it has confirmed this return, with bonus."""
    steps: int
    """Steps of the environment in a run with the default budget, at most."""
    policy: Callable[[Circuit], Policy]
    """Puts the task's sensing and motors around a circuit."""
    margin: float = 0.05
    """Difference of returns that counts as none."""
    threshold_from: str = "ours"
    """Origin of ``success``; the paper states no threshold."""
    published_search: str = "published-parking"
    wiring: str = "tap_withdrawal"
    """Name of the tap-withdrawal circuit with the task's motor neurons."""
    warm_up: int = 0
    """Ticks of a circuit before the first step of an episode, in the task's published code."""
    untuned: int = 1
    """Untuned agents that are tried before the default search begins."""

    def circuit(self) -> Circuit:
        """Return the untuned circuit."""
        return load_circuit(self.wiring)


@dataclass(frozen=True, kw_only=True)
class Benchmark(Task):
    """One of Gymnasium's tasks, run in lanes."""

    published_search: str = "published-benchmarks"
    plant: int
    start: Callable[[np.random.Generator], FloatArray]
    """Draws the first state as the environment's reset does."""
    environment: str
    model: MujocoModel | None = None
    search_plant: int | None = None
    """A faster plant for the search; reported results are those of ``plant``."""
    bonus: float = 0.0
    """Added to every rewarded step, times 1 - |x| of the cart."""
    warm_up: int = 1
    most: float = math.inf
    """Upper bound of a return, with bonus."""
    untuned: int = 3000


def two_signals(name: str, inputs: dict[str, float], limit: float) -> Callable[[Circuit], Policy]:
    """Return the mapping of two signals to the touch neurons in pairs, and of FWD and REV to one action."""
    pairs = (("PLM", "AVM"), ("ALM", "PVD"))
    channels = tuple(
        Channel(name=signal, positive=positive, maximum=end, negative=negative, minimum=-end)
        for (signal, end), (positive, negative) in zip(inputs.items(), pairs, strict=True)
    )
    sensing = Sensing(name=name, inputs=tuple(inputs), channels=channels)
    action = Channel(name="action", positive="FWD", maximum=limit, negative="REV", minimum=-limit)
    motors = Motors(outputs=("action",), channels=(action,))
    return lambda circuit: Policy(circuit, sensing, motors)


_JOINTS = ("back_thigh", "back_shin", "back_foot", "front_thigh", "front_shin", "front_foot")
_CHEETAH_RANGES = (0.1, 0.3, *(0.5,) * 6, 1.5, 1.0, 1.5, *(6.0,) * 6)
"""Usual size of a half-cheetah's observations, so that a weight means about the same to each."""


def _cheetah_policy(circuit: Circuit) -> Policy:
    """Put the two linear layers, 17 to 2 and 2 to 6, around a circuit."""
    places = ("z", "pitch", *_JOINTS)
    inputs = (*places, "v_x", *(f"{place}_rate" for place in places))
    sensing = Sensing(
        name="half-cheetah",
        inputs=inputs,
        ranges=_CHEETAH_RANGES,
        channels=(
            Channel(name="first", positive="PLM", maximum=1.0, negative="AVM", minimum=-1.0),
            Channel(name="second", positive="ALM", maximum=1.0, negative="PVD", minimum=-1.0),
        ),
    )
    motors = Motors(
        outputs=_JOINTS,
        limits=(1.0,) * len(_JOINTS),
        channels=(
            Channel(name="forward", positive="FWD", maximum=1.0),
            Channel(name="reverse", positive="REV", maximum=1.0),
        ),
    )
    layers = np.zeros((2, len(inputs))), np.zeros((len(_JOINTS), 2))
    return Policy(circuit, sensing, motors, input_layer=layers[0], output_layer=layers[1])


def _pendulum(name: str, title: str, roboschool: bool) -> Benchmark:
    return Benchmark(
        name=name,
        title=title,
        settings=Settings(25_000, 20, 10),
        horizon=1000,
        success=950.0,
        margin=60.0,
        enough=1194.5,
        steps=12_000_000,
        policy=two_signals("pendulum", {"angle": 0.12, "cart": 1.0}, 0.3),
        threshold_from="Gymnasium",
        plant=PENDULUM,
        start=lambda rng: (
            np.array([0.0, rng.uniform(-0.1, 0.1), 0.0, 0.0]) if roboschool else rng.uniform(-0.01, 0.01, 4)
        ),
        environment="InvertedPendulum-v5",
        model=MujocoModel("inverted_pendulum.xml", *((0.0165, 1) if roboschool else (0.02, 2))),
        search_plant=WRITTEN_PENDULUM,
        bonus=0.2,
        most=1200.0,
        untuned=5000,
    )


def _parking(name: str, title: str, wiring: str) -> Task:
    return Task(
        name=name,
        title=title,
        settings=Settings(20_000, 1, 1),
        horizon=320,
        success=-0.1,
        enough=-0.03,
        steps=320 * 100_000,
        policy=parking_policy,
        wiring=wiring,
    )


_ALL = (
    _pendulum("pendulum", "Inverted pendulum", False),
    _pendulum("roboschool", "Inverted pendulum, Roboschool's step and start", True),
    Benchmark(
        name="mountain-car",
        title="Mountain car",
        settings=Settings(50_000, 20, 20),
        horizon=999,
        success=90.0,
        margin=5.0,
        enough=98.0,
        steps=40_000_000,
        policy=two_signals("mountain-car", {"position": 1.0, "velocity": 0.02}, 1.0),
        threshold_from="Gymnasium",
        published_search="published-mountain-car",
        plant=MOUNTAIN_CAR,
        start=lambda rng: np.array([rng.uniform(-0.6, -0.4), 0.0]),
        most=100.0,
        environment="MountainCarContinuous-v0",
    ),
    Benchmark(
        name="half-cheetah",
        title="Half-cheetah",
        settings=Settings(20_000, 10, 5),
        horizon=1000,
        success=2000.0,
        margin=200.0,
        enough=6000.0,
        steps=6_000_000,
        policy=_cheetah_policy,
        plant=HALF_CHEETAH,
        start=lambda rng: np.concatenate([rng.uniform(-0.1, 0.1, 9), 0.1 * rng.standard_normal(9)]),
        environment="HalfCheetah-v5",
        model=MujocoModel("half_cheetah.xml", 0.01, 5),
        untuned=400,
    ),
    Benchmark(
        name="cart-pole",
        title="Cart-pole, continuous force",
        settings=Settings(50_000, 20, 10),
        horizon=500,
        success=475.0,
        margin=25.0,
        warm_up=0,
        enough=499.0,
        steps=60_000_000,
        policy=two_signals("cart-pole", {"angle": 0.15, "rate": 1.0}, 1.0),
        threshold_from="Gymnasium",
        plant=CART_POLE,
        start=lambda rng: rng.uniform(-0.05, 0.05, 4),
        most=500.0,
        environment="CartPole-v1",
    ),
    _parking("parking", "Parking", "parking"),
    _parking("four-dof", "Parking, four degrees of freedom", "four_dof"),
)
TASKS = {task.name: task for task in _ALL}


def find_task(name: str) -> Task:
    """Return a task by its name; raises UsageError, which lists all names."""
    if name not in TASKS:
        raise UsageError(f"no task {name!r}; there are {', '.join(TASKS)}")
    return TASKS[name]
