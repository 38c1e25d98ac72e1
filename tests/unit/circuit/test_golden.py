"""Traces of the paper's published simulator (float32, C++), see data/golden/README.md."""

import numpy as np
import pytest
from kit.paths import DATA

from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.policy_file import load_start
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Channel, Sensing, parking_sensing

GOLDEN = DATA / "golden"

BENCHMARK_SENSING = Sensing(
    name="benchmark",
    inputs=("phi", "x"),
    channels=(
        Channel(name="phi", positive="PLM", maximum=0.3, negative="AVM", minimum=-0.3),
        Channel(name="x", positive="ALM", maximum=0.02, negative="PVD", minimum=-0.02),
    ),
)
BENCHMARK_MOTORS = Motors(
    outputs=("action",),
    channels=(Channel(name="action", positive="FWD", maximum=1.0, negative="REV", minimum=-1.0),),
)
# name, mappings, which recorded input is which of ours, the recorded outputs' full scale in our units
CASES = [
    ("parking", parking_sensing(), parking_motors(), (0, 1, 3, 2), (0.16, 0.18)),
    ("parking", parking_sensing(clamp=False), parking_motors(), (0, 1, 3, 2), (0.16, 0.18)),
    ("tap_withdrawal", BENCHMARK_SENSING, BENCHMARK_MOTORS, (0, 1), (1.0,)),
    ("random_wiring", BENCHMARK_SENSING, BENCHMARK_MOTORS, (0, 1), (1.0,)),
]


@pytest.mark.parametrize(("name", "sensing", "motors", "inputs", "scale"), CASES)
def test_reproduces_the_published_simulator(name, sensing, motors, inputs, scale):
    start = load_start(GOLDEN / f"{name}.yaml")
    circuit = start.circuit if isinstance(start, Policy) else start
    runner = Runner(Policy(circuit, sensing, motors))
    trace = np.genfromtxt(GOLDEN / f"{name}.csv", delimiter=",", names=True)
    compared = [i for i, neuron in enumerate(circuit.neurons) if neuron not in {"PVD", "PLM", "AVM", "ALM"}]
    assert len(trace) == 500

    for row in trace:
        command = runner.tick([row[f"in{i}"] for i in inputs])
        recorded = np.array([row[f"v{i}"] for i in range(circuit.size)])
        np.testing.assert_allclose(runner.potentials[compared], recorded[compared], atol=0.002, rtol=0)
        outputs = [row[f"out{i}"] for i in range(len(scale))]
        # 40 mV are the motors' full scale: 0.002 mV are 5e-5 of it.
        np.testing.assert_allclose(np.array(command) / scale, outputs, atol=1e-4, rtol=0)
