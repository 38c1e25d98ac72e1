import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.circuit.circuit import RESTING_MV, ParameterKind, SynapseKind
from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Sensing, parking_sensing
from rover_ncp.core.errors import ConfigError, UsageError

CIRCUIT = load_circuit("parking")
PARKING = parking_policy(CIRCUIT)
LAYERED = Policy(
    CIRCUIT,
    Sensing(name="layered", inputs=("a", "b"), channels=parking_sensing().channels),
    Motors(outputs=("p", "q", "r"), channels=parking_motors().channels),
    input_layer=np.arange(8).reshape(4, 2) / 4,
    output_layer=np.arange(6).reshape(3, 2) / -3,
)


@given(st.integers(0, 2**32))
def test_parameters_come_back(seed):
    layout = LAYERED.layout()
    vector = np.random.default_rng(seed).uniform(layout.lower, layout.upper)
    changed = LAYERED.with_parameters(vector)
    assert changed.parameters().tobytes() == vector.tobytes()
    assert changed.input_layer.shape == (4, 2)
    gap = changed.circuit.kind == SynapseKind.GAP
    np.testing.assert_array_equal(
        changed.circuit.sigma[~gap], vector[layout.block(ParameterKind.SIGMA).slice]
    )


@pytest.mark.parametrize("block", LAYERED.layout().blocks, ids=lambda block: block.kind)
def test_refuses_parameters_out_of_bounds_and_a_vector_of_another_length(block):
    with pytest.raises(ConfigError, match="needs 108 parameters"):
        LAYERED.with_parameters(np.ones(107))
    for value in (math.nan, math.inf, -math.inf, block.lower - 0.01, block.upper + 0.01):
        vector = LAYERED.parameters()
        vector[block.slice.stop - 1] = value
        with pytest.raises(ConfigError, match=f"{block.kind}.* outside"):
            LAYERED.with_parameters(vector)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"circuit": load_circuit("tap_withdrawal")}, "motors.channels[1]: the circuit has no neuron 'LFT'"),
        ({"dt_s": math.nan}, "dt_s: must be above 0 and at most 1 s, got nan"),
        ({"substeps": 0}, "substeps: must be in 1..10000, got 0"),
        ({"input_layer": np.ones((4, 3))}, "input_layer: needs 4 rows of 4 numbers, got the shape (4, 3)"),
        ({"output_layer": np.full((2, 2), 4.0)}, "output_layer[0][0]: 4 is outside -3..3"),
        (
            {"motors": Motors(outputs=("a", "b"), channels=parking_motors().channels)},
            "output_layer: is missing, and without it these would have to be the same: v, omega and a, b",
        ),
    ],
)
def test_refuses_parts_that_do_not_fit(changes, problem):
    parts = {"circuit": CIRCUIT, "sensing": parking_sensing(), "motors": parking_motors()}
    with pytest.raises(ConfigError) as caught:
        Policy(**(parts | changes))
    assert problem in caught.value.problems


@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_runner_rejects_non_finite_observations_and_keeps_its_state(value):
    runner = Runner(PARKING)
    runner.tick([0.1, 0.2, 0.3, 1.0])
    before = runner.potentials
    with pytest.raises(UsageError, match="the observation theta is "):
        runner.tick([0.1, 0.2, value, 1.0])
    with pytest.raises(UsageError, match=r"needs 4 values \(x, y, theta, start\)"):
        runner.tick([0.0, 0.0, 0.0])
    assert runner.potentials.tobytes() == before.tobytes()


def test_runner_starts_at_rest_and_returns_to_it():
    runner = Runner(PARKING)
    assert (runner.potentials == RESTING_MV).all()
    first = runner.tick([0.5, 0.5, 0.5, 1.0])
    again = runner.tick([0.5, 0.5, 0.5, 1.0])
    assert again != first
    runner.reset()
    assert (runner.potentials == RESTING_MV).all()
    assert runner.tick([0.5, 0.5, 0.5, 1.0]) == first
