"""What a tick of a circuit costs by its size.

    python -m benchmarks.circuit

prints one JSON object: the CPU time of a tick, ten substeps, of circuits of 24 to 192 neurons and 60 to 480
synapses, and a linear fit.
"""

import json
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from paper.tasks import random_circuit
from rover_ncp.circuit.policy import parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner

REPEATS = 5
TICKS = 40
SIZES = tuple((neurons, synapses) for neurons in (24, 48, 96, 192) for synapses in (60, 120, 240, 480))


def median_cpu_s(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Return the median CPU time of each call after a warm-up call; calls alternate, as load varies."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for repeat in range(REPEATS + 1):
        for name, run in calls.items():
            began = time.process_time()
            run()
            if repeat:
                times[name].append(time.process_time() - began)
    return {name: statistics.median(each) for name, each in times.items()}


def tick_alone(runner: Runner) -> None:
    """Run a circuit for some ticks."""
    for _ in range(TICKS):
        runner.tick([0.3, 0.3, 0.3, 1.0])


def bench_circuit() -> dict[str, Any]:
    """Measure what a tick of a random circuit costs, by its numbers of neurons and synapses."""
    calls: dict[str, Callable[[], object]] = {}
    own = load_circuit("parking").neurons
    for neurons, synapses in SIZES:
        names = (*own, *(f"N{number}" for number in range(neurons - len(own))))
        runner = Runner(parking_policy(random_circuit(0, names, synapses)))
        calls[f"{neurons} {synapses}"] = partial(tick_alone, runner)
    costs = np.array(list(median_cpu_s(calls).values())) * 1e6 / TICKS
    columns = np.column_stack([np.ones(len(SIZES)), SIZES])
    fit = np.linalg.lstsq(columns, costs, rcond=None)[0]
    return {
        "sizes": [  #: of the circuits, called from Python
            {
                "neurons": neurons,
                "synapses": synapses,
                "tick_us": cost,  #: CPU time of ten substeps
            }
            for (neurons, synapses), cost in zip(SIZES, costs.tolist(), strict=True)
        ],
        "fixed_us": float(fit[0]),  #: part of a tick that no size changes, of a linear fit
        "neuron_us": float(fit[1]),  #: part of each neuron
        "synapse_us": float(fit[2]),  #: part of each synapse
        "most_off": float(np.abs(columns @ fit / costs - 1.0).max()),  #: of the fit, as a share of the cost
    }


if __name__ == "__main__":
    print(json.dumps(bench_circuit(), indent=2))
