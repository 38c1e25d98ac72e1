from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from rover_ncp.circuit.circuit import build_circuit
from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, PolicyRunner, course_policy, parking_policy
from rover_ncp.circuit.sensing import Channel, Sensing, parking_sensing, shifted_sensing
from rover_ncp.circuit.tap_withdrawal import parking_circuit, tap_withdrawal_circuit
from rover_ncp.core.errors import ConfigError

UNCONNECTED = build_circuit("unconnected", ("up", "down", "alone", "M", "N"), ())
MOTORS = Motors(outputs=("y",), channels=(Channel(name="y", positive="M", maximum=1.0),))


def potentials_of(clamp, pair, single):
    """Return the potentials of both neurons of a pair over -2..4 and of a single neuron over 0..5."""
    sensing = Sensing(
        name="test",
        inputs=("pair", "single"),
        clamp=clamp,
        channels=(
            Channel(name="pair", positive="up", maximum=4.0, negative="down", minimum=-2.0),
            Channel(name="single", positive="alone", maximum=5.0),
        ),
    )
    runner = PolicyRunner(Policy(UNCONNECTED, sensing, MOTORS))
    runner.tick([pair, single])
    return tuple(runner.potentials[:3])


@pytest.mark.parametrize(
    ("clamp", "pair", "single", "expected"),
    [
        (True, 0.0, 0.0, (-70, -70, -70)),
        (True, 4.0, 5.0, (-20, -70, -20)),
        (True, 2.0, 2.5, (-45, -70, -45)),
        (True, -1.0, -1.0, (-70, -45, -70)),
        (True, 8.0, 50.0, (-20, -70, -20)),
        (True, -8.0, -50.0, (-70, -20, -70)),
        (False, 2.0, 2.5, (-45, -70, -45)),
        (False, 8.0, 10.0, (30, -70, 30)),
        (False, -8.0, -1.0, (-70, 130, -80)),
        (False, 1e9, -1e9, (1000, -70, -1000)),
    ],
)
def test_sensory_potentials(clamp, pair, single, expected):
    assert potentials_of(clamp, pair, single) == pytest.approx(expected, abs=1e-9)


def held_motors(positive_mV, negative_mV):
    circuit = build_circuit("held", ("S", "LFT", "RGT", "FWD"), ())
    object.__setattr__(circuit, "held", {1: positive_mV, 2: negative_mV, 3: positive_mV})
    sensing = Sensing(name="test", inputs=("x",), channels=(Channel(name="x", positive="S", maximum=1.0),))
    return PolicyRunner(Policy(circuit, sensing, parking_motors())).tick([0.0])


@pytest.mark.parametrize(
    ("positive_mV", "negative_mV", "v", "omega"),
    [
        (-60.0, -60.0, 0.0, 0.0),
        (-20.0, -60.0, 0.16, 0.18),
        (-60.0, -20.0, 0.0, -0.18),
        (-20.0, -20.0, 0.16, 0.0),
        (-40.0, -50.0, 0.08, 0.045),
        (-90.0, -61.0, 0.0, 0.0),
        (0.0, -90.0, 0.16, 0.18),
    ],
)
def test_motor_outputs(positive_mV, negative_mV, v, omega):
    assert held_motors(positive_mV, negative_mV) == pytest.approx((v, omega), abs=1e-12)


@given(st.floats(-90, 0), st.floats(-90, 0))
def test_commands_never_leave_the_motors_range(positive_mV, negative_mV):
    v, omega = held_motors(positive_mV, negative_mV)
    assert 0 <= v <= 0.16
    assert -0.18 <= omega <= 0.18


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"positive": "A"}, "positive neuron and a maximum go together"),
        ({"maximum": 1.0}, "positive neuron and a maximum go together"),
        ({"negative": "A"}, "negative neuron and a minimum go together"),
        ({}, "needs a positive or a negative neuron"),
        ({"positive": "A", "maximum": 0.0}, "greater than 0"),
        ({"negative": "A", "minimum": 1.0}, "less than 0"),
        ({"positive": "A", "maximum": float("nan")}, "finite"),
    ],
)
def test_refuses_a_channel_that_cannot_be(fields, problem):
    with pytest.raises(ValidationError, match=problem):
        Channel(name="x", **fields)


def test_rejects_duplicate_names():
    def channel(name, neuron):
        return Channel(name=name, positive=neuron, maximum=1.0)

    for inputs, channels, problem in (
        (("x", "x"), (channel("x", "A"), channel("y", "B")), "input 'x' appears twice"),
        (("x", "y"), (channel("x", "A"), channel("x", "B")), "channel 'x' appears twice"),
        (("x", "y"), (channel("x", "A"), channel("y", "A")), "sensory neuron 'A' appears twice"),
    ):
        with pytest.raises(ValidationError, match=problem):
            Sensing(name="test", inputs=inputs, channels=channels)
    with pytest.raises(ValidationError, match="output 'v' appears twice"):
        Motors(outputs=("v", "v"), channels=(channel("v", "A"), channel("w", "B")))


def test_refuses_a_motor_range_upside_down():
    with pytest.raises(ValidationError, match="low_mV must be below high_mV"):
        Motors(outputs=("y",), channels=MOTORS.channels, low_mV=-20.0, high_mV=-60.0)


def test_one_neuron_may_drive_two_outputs():
    # The four-degrees-of-freedom variant (supplement 6): AVA right and backward, AVB left and forward.
    motors = Motors(
        outputs=("v", "omega"),
        channels=(
            Channel(name="v", positive="AVB", maximum=0.16, negative="AVA", minimum=-0.16),
            Channel(name="omega", positive="AVB", maximum=0.18, negative="AVA", minimum=-0.18),
        ),
    )
    runner = PolicyRunner(Policy(parking_circuit(), parking_sensing(), motors))
    v, omega = runner.tick([0.3, 0.2, 0.1, 1.0])
    share = np.clip((runner.potentials[[5, 2]] + 60) / 40, 0, 1)
    assert v == pytest.approx(0.16 * (share[0] - share[1]), abs=1e-12)
    assert omega == pytest.approx(0.18 * (share[0] - share[1]), abs=1e-12)
    assert v != 0


@pytest.mark.parametrize(
    ("x", "expected"), [(-0.15, -70), (0.0, -70 + 50 * 0.15 / 1.15), (1.0, -20), (2.0, -20)]
)
def test_shifted_ranges_begin_at_their_origins(x, expected):
    policy = replace(parking_policy(parking_circuit()), sensing=shifted_sensing())
    runner = PolicyRunner(policy)
    runner.tick([x, -0.15, -0.25, 0.0])
    potentials = dict(zip(policy.circuit.neurons, runner.potentials, strict=True))
    assert potentials["PVD"] == pytest.approx(expected)
    assert potentials["PLM"] == potentials["ALM"] == potentials["AVM"] == pytest.approx(-70)


def test_layers_work_on_parts_of_ranges_and_limits():
    policy = course_policy(tap_withdrawal_circuit())
    runner = PolicyRunner(policy)
    # Of the first mixture: half of longitudinal's range, and of speed's a quarter at weight 0.6.
    runner.tick([0.1, 0.0, 0.0, 0.04, 0.0])
    potentials = dict(zip(policy.circuit.neurons, runner.potentials, strict=True))
    assert potentials["PLM"] == pytest.approx(-70 + 50 * (0.5 + 0.6 / 4))
    assert potentials["AVM"] == pytest.approx(-70)
    loud = replace(policy, output_layer=np.array([[3.0, 3.0], [-3.0, 3.0]]))
    object.__setattr__(loud.circuit, "held", {9: -20.0, 10: -70.0})
    assert PolicyRunner(loud).tick([0.0] * 5) == pytest.approx((0.24, -0.36))
    object.__setattr__(loud.circuit, "held", {9: -56.0, 10: -56.0})
    assert PolicyRunner(loud).tick([0.0] * 5) == pytest.approx((0.24 * 0.6, 0.0))


@pytest.mark.parametrize(
    ("part", "changes", "expected"),
    [
        ("sensing", {"ranges": (1.0, 1.0)}, "as many ranges as inputs, got 2"),
        ("sensing", {"ranges": (1.0, 1.0, 1.0, 0.0, 1.0)}, "greater than 0"),
        ("motors", {"limits": (0.24,)}, "as many limits as outputs, got 1"),
        (
            "motors",
            {"channels": ({"name": "v", "positive": "FWD", "maximum": 1, "origin": 0.1},)},
            "no origin",
        ),
    ],
)
def test_ranges_and_limits_must_fit(part, changes, expected):
    policy = course_policy(tap_withdrawal_circuit())
    model = getattr(policy, part)
    with pytest.raises(ValidationError, match=expected):
        type(model).model_validate(model.model_dump(exclude_none=True) | changes)


def test_without_layers_there_are_no_ranges_and_limits():
    policy = course_policy(tap_withdrawal_circuit())
    with pytest.raises(ConfigError, match="without an input layer the channels have the ranges"):
        replace(policy, input_layer=None)
    with pytest.raises(ConfigError, match="without an output layer the channels have the limits"):
        replace(policy, output_layer=None)
