"""Facts about circuits, mappings and settings that claims compare with the paper's, as plain values."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rover_ncp.circuit.circuit import BOUNDS, ParameterKind
from sim.learn.random_circuit import random_circuit
from sim.paper.agents import build_agent
from sim.paper.interpretation import drives, time_constants
from sim.paper.results import ResultStore
from sim.paper.tasks import TASKS

_COMPARED = ("circuit", "mlp", "lstm")


def _size(_: ResultStore, task: str) -> str:
    circuit = TASKS[task].circuit()
    return f"{circuit.size} neurons, {circuit.synapse_count} synapses"


def _sparsity(_: ResultStore) -> float:
    circuit = TASKS["pendulum"].circuit()
    return round(1.0 - circuit.synapse_count / circuit.size**2, 2)


def _fewest_parameters(_: ResultStore, task: str) -> str:
    sizes = {agent: build_agent(TASKS[task], agent, 0).layout().size for agent in _COMPARED}
    fewest = min(sizes, key=sizes.__getitem__)
    return f"{fewest} with {sizes[fewest]}"


def _random_synapses(_: ResultStore) -> list[int]:
    circuit = TASKS["pendulum"].circuit()
    wirings = (random_circuit(seed, circuit.neurons, circuit.synapse_count) for seed in range(20))
    return sorted({wiring.synapse_count for wiring in wirings})


def _bounds(_: ResultStore, kind: str) -> list[float]:
    return list(BOUNDS[ParameterKind(kind)][:2])


def _motor_range_mv(_: ResultStore) -> list[float]:
    motors = TASKS["pendulum"].policy(TASKS["pendulum"].circuit()).motors
    return [motors.low_mV, motors.high_mV]


def _input_range(_: ResultStore, task: str, signal: str) -> float:
    channels = TASKS[task].policy(TASKS[task].circuit()).sensing.channels
    return next(max(end for _, end in channel.sides) for channel in channels if channel.name == signal)


def _settings(_: ResultStore, task: str) -> list[int]:
    found = TASKS[task]
    return [found.settings.iterations, found.horizon, found.settings.rollouts, found.settings.worst]


def _neurons(_: ResultStore, task: str) -> str:
    policy = TASKS[task].policy(TASKS[task].circuit())
    return "; ".join(
        f"{channel.name} {' '.join(neuron for neuron, _ in channel.sides)}"
        for channel in (*policy.sensing.channels, *policy.motors.channels)
    )


def _potentials_within(store: ResultStore) -> bool | None:
    found = [drive.potentials for _, drive in drives(store)]
    return all(bool(np.all((each >= -90.0) & (each <= 0.0))) for each in found) if found else None


def _overlapping_time_constants(
    store: ResultStore, task: str, ranges: Mapping[str, tuple[float, float]]
) -> str | None:
    ours = time_constants(store, task)
    same = [n for n, (low, high) in ranges.items() if n in ours and ours[n][0] <= high and low <= ours[n][1]]
    return f"{len(same)} of {len(ranges)} ranges overlap" if ours else None


def _varying_time_constants(store: ResultStore) -> str | None:
    ours = time_constants(store, "parking")
    varying = sum(high > 1.01 * low for low, high in ours.values())
    return f"{varying} of {len(ours)} neurons" if ours else None


FACTS: Mapping[str, Callable[..., Any]] = {
    "size": _size,
    "sparsity": _sparsity,
    "parameters": _fewest_parameters,
    "random-synapses": _random_synapses,
    "bounds": _bounds,
    "motor-range": _motor_range_mv,
    "input-range": _input_range,
    "settings": _settings,
    "neurons": _neurons,
    "potentials": _potentials_within,
    "time-constants": _overlapping_time_constants,
    "varying": _varying_time_constants,
}
