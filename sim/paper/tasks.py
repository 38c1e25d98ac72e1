"""The paper's tasks: environment, mappings, settings, and what counts as success.

Mappings and settings: Hasani et al. (ICRA 2020), Tables S1 and S3. Thresholds are Gymnasium's where it has
one. A pendulum's paper return has a bonus of 0.2 (1 - |x|) on every rewarded step, so it ends at 1200.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.circuit.motors import Motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.sensing import Channel, Sensing
from rover_ncp.circuit.tap_withdrawal import four_dof_circuit, parking_circuit, tap_withdrawal_circuit
from rover_ncp.core.errors import UsageError
from sim.paper.plants import (
    CART_POLE,
    CHEETAH,
    MOUNTAIN_CAR,
    PENDULUM,
    WRITTEN_CHEETAH,
    WRITTEN_PENDULUM,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """How the paper searches: candidates, rollouts of each, and how many worst ones are averaged."""

    iterations: int
    rollouts: int
    worst: int


@dataclass(frozen=True)
class MujocoModel:
    """A model of Gymnasium's, steps of it in one of the environment, and their length if not the model's."""

    file: str
    frames: int
    step_s: float | None = None


class SearchName(StrEnum):
    """How a benchmark is searched by default."""

    PUBLISHED = "published"
    """``search.py``, as the paper does, and what makes it cheaper."""
    CMA = "cma"
    """``cma_search.py``."""
    EVOLUTION = "evolution"
    """``evolution.py``."""


class StandIn(NamedTuple):
    """A plant written out here that equals MuJoCo's, and steps of so long in one of the environment."""

    plant: int
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
    """A run succeeds whose mean return, without bonus, is at least this."""
    enough: float
    """A search that has confirmed such a return, with bonus, may stop."""
    steps: int
    """Steps of the environment that a run takes by default, at most."""
    circuit: Callable[[], Circuit]
    """The untuned tap-withdrawal circuit with the task's motor neurons."""
    policy: Callable[[Circuit], Policy]
    """Puts the task's sensing and motors around a circuit."""


@dataclass(frozen=True)
class Benchmark(Task):
    """A task of Gymnasium's, run in lanes."""

    plant: int = MOUNTAIN_CAR
    start: Callable[[np.random.Generator], FloatArray] = field(default=lambda generator: np.zeros(0))
    """Draws the first state as the environment's reset does."""
    environment: str = ""
    mujoco: MujocoModel | None = None
    stand_in: StandIn | None = None
    """A plant that replaces MuJoCo in the search; results are MuJoCo's."""
    search: SearchName = SearchName.PUBLISHED
    bonus: float = 0.0
    starts: int = 3000
    """Untuned agents that are tried before the search begins."""


def two_signals(name: str, inputs: tuple[tuple[str, float], ...], end: float) -> Callable[[Circuit], Policy]:
    """Return the mapping of two signals to the touch neurons in pairs, and of FWD and REV to one action."""
    pairs = (("PLM", "AVM"), ("ALM", "PVD"))
    channels = tuple(
        Channel(name=signal, positive=positive, maximum=limit, negative=negative, minimum=-limit)
        for (signal, limit), (positive, negative) in zip(inputs, pairs, strict=True)
    )
    sensing = Sensing(name=name, inputs=tuple(signal for signal, _ in inputs), channels=channels)
    action = Channel(name="action", positive="FWD", maximum=end, negative="REV", minimum=-end)
    motors = Motors(outputs=("action",), channels=(action,))
    return lambda circuit: Policy(circuit, sensing, motors)


_CHEETAH_RANGES = (0.1, 0.3, *(0.5,) * 6, 1.5, 1.0, 1.5, *(6.0,) * 6)
"""How large a half-cheetah's observations usually are, so that a weight means about the same to each."""


def _cheetah_policy(circuit: Circuit) -> Policy:
    """Put the two linear layers, 17 to 2 and 2 to 6, around a circuit."""
    joints = ("back_thigh", "back_shin", "back_foot", "front_thigh", "front_shin", "front_foot")
    places = ("z", "pitch", *joints)
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
        outputs=joints,
        limits=(1.0,) * len(joints),
        channels=(
            Channel(name="forward", positive="FWD", maximum=1.0),
            Channel(name="reverse", positive="REV", maximum=1.0),
        ),
    )
    return Policy(
        circuit,
        sensing,
        motors,
        input_layer=np.zeros((2, len(inputs))),
        output_layer=np.zeros((len(joints), 2)),
    )


def _car_start(generator: np.random.Generator) -> FloatArray:
    return np.array([generator.uniform(-0.6, -0.4), 0.0])


def _cart_pole_start(generator: np.random.Generator) -> FloatArray:
    return generator.uniform(-0.05, 0.05, 4)


def _pendulum_start(generator: np.random.Generator) -> FloatArray:
    return generator.uniform(-0.01, 0.01, 4)


def _roboschool_start(generator: np.random.Generator) -> FloatArray:
    return np.array([0.0, generator.uniform(-0.1, 0.1), 0.0, 0.0])


def _cheetah_start(generator: np.random.Generator) -> FloatArray:
    return np.concatenate([generator.uniform(-0.1, 0.1, 9), 0.1 * generator.standard_normal(9)])


def _pendulum(name: str, title: str, roboschool: bool, bonus: float) -> Benchmark:
    return Benchmark(
        name=name,
        title=title,
        settings=Settings(25_000, 20, 10),
        horizon=1000,
        success=950.0,
        enough=999.5 + 195.0 * bonus / 0.2,
        steps=12_000_000,
        circuit=tap_withdrawal_circuit,
        policy=two_signals("pendulum", (("angle", 0.12), ("cart", 1.0)), 0.3),
        plant=PENDULUM,
        start=_roboschool_start if roboschool else _pendulum_start,
        environment="InvertedPendulum-v5",
        mujoco=MujocoModel("inverted_pendulum.xml", 1, 0.0165)
        if roboschool
        else MujocoModel("inverted_pendulum.xml", 2),
        stand_in=StandIn(WRITTEN_PENDULUM, 0.0165, 1) if roboschool else StandIn(WRITTEN_PENDULUM, 0.02, 2),
        search=SearchName.CMA,
        bonus=bonus,
        starts=5000,
    )


def _parking(name: str, title: str, circuit: Callable[[], Circuit]) -> Task:
    return Task(
        name=name,
        title=title,
        settings=Settings(20_000, 1, 1),
        horizon=320,
        success=-0.1,
        enough=-0.03,
        steps=320 * 100_000,
        circuit=circuit,
        policy=parking_policy,
    )


_ALL = (
    _pendulum("pendulum", "Inverted pendulum", False, 0.2),
    _pendulum("pendulum-plain", "Inverted pendulum, no bonus", False, 0.0),
    _pendulum("roboschool", "Inverted pendulum, Roboschool's step and start", True, 0.2),
    _pendulum("roboschool-plain", "Inverted pendulum, Roboschool's step and start, no bonus", True, 0.0),
    Benchmark(
        name="mountain-car",
        title="Mountain car",
        settings=Settings(50_000, 20, 20),
        horizon=999,
        success=90.0,
        enough=98.0,
        steps=40_000_000,
        circuit=tap_withdrawal_circuit,
        policy=two_signals("mountain-car", (("position", 1.0), ("velocity", 0.02)), 1.0),
        plant=MOUNTAIN_CAR,
        start=_car_start,
        environment="MountainCarContinuous-v0",
    ),
    Benchmark(
        name="half-cheetah",
        title="Half-cheetah",
        settings=Settings(20_000, 10, 5),
        horizon=1000,
        success=2000.0,
        enough=6000.0,
        steps=6_000_000,
        circuit=tap_withdrawal_circuit,
        policy=_cheetah_policy,
        plant=CHEETAH,
        start=_cheetah_start,
        environment="HalfCheetah-v5",
        mujoco=MujocoModel("half_cheetah.xml", 5),
        stand_in=StandIn(WRITTEN_CHEETAH, 0.01, 5),
        search=SearchName.EVOLUTION,
        starts=400,
    ),
    Benchmark(
        name="cart-pole",
        title="Cart-pole, continuous force",
        settings=Settings(50_000, 20, 10),
        horizon=500,
        success=475.0,
        enough=499.0,
        steps=60_000_000,
        circuit=tap_withdrawal_circuit,
        policy=two_signals("cart-pole", (("angle", 0.15), ("rate", 1.0)), 1.0),
        plant=CART_POLE,
        start=_cart_pole_start,
        environment="CartPole-v1",
    ),
    _parking("parking", "Parking", parking_circuit),
    _parking("four-dof", "Parking, four degrees of freedom", four_dof_circuit),
)
TASKS = {task.name: task for task in _ALL}


def find_task(name: str) -> Task:
    """Return a task by its name; raises UsageError, naming them all."""
    if name not in TASKS:
        raise UsageError(f"no task {name!r}; there are {', '.join(TASKS)}")
    return TASKS[name]
