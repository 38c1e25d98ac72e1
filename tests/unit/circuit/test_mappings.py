from dataclasses import replace

import pytest
from kit.wirings import build_circuit
from pydantic import ValidationError

from rover_ncp.circuit.motors import Motors, four_dof_motors, parking_motors
from rover_ncp.circuit.policy import Policy, absolute_policy, course_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Channel, Sensing, parking_sensing
from rover_ncp.course.course import load_course

UNCONNECTED = build_circuit("unconnected", ("up", "down", "alone", "M", "N"), ())
MOTORS = Motors(outputs=("y",), channels=(Channel(name="y", positive="M", maximum=1.0),))


@pytest.mark.parametrize(
    ("clamp", "pair", "single", "expected"),
    [
        (True, 0.0, 0.0, (-70, -70, -70)),
        (True, 4.0, 5.0, (-20, -70, -20)),
        (True, -1.0, -1.0, (-70, -45, -70)),
        (True, 8.0, 50.0, (-20, -70, -20)),
        (False, 8.0, 10.0, (30, -70, 30)),
        (False, -8.0, -1.0, (-70, 130, -80)),
        (False, 1e9, -1e9, (1000, -70, -1000)),
    ],
)
def test_sensory_potentials(clamp, pair, single, expected):
    channels = (
        Channel(name="pair", positive="up", maximum=4.0, negative="down", minimum=-2.0),
        Channel(name="single", positive="alone", maximum=5.0),
    )
    sensing = Sensing(name="test", inputs=("pair", "single"), clamp=clamp, channels=channels)
    runner = Runner(Policy(UNCONNECTED, sensing, MOTORS))
    runner.tick([pair, single])
    assert tuple(runner.potentials[:3]) == pytest.approx(expected, abs=1e-9)


X, Y = ({"name": name, "positive": neuron, "maximum": 1.0} for name, neuron in (("x", "A"), ("y", "B")))
SENSING = {"name": "test", "inputs": ("x", "y"), "channels": (X, Y)}
MOTOR = {"outputs": ("x", "y"), "channels": (X, Y)}


@pytest.mark.parametrize(
    ("model", "fields", "problem"),
    [
        (Channel, {"name": "x", "positive": "A"}, "positive neuron and a maximum go together"),
        (Channel, {"name": "x"}, "needs a positive or a negative neuron"),
        (Sensing, SENSING | {"inputs": ("x", "x")}, "input 'x' appears twice"),
        (Sensing, SENSING | {"channels": (X, Y | {"positive": "A"})}, "sensory neuron 'A' appears twice"),
        (Sensing, SENSING | {"ranges": (1.0,)}, "as many ranges as inputs, got 1"),
        (Motors, MOTOR | {"outputs": ("v", "v")}, "output 'v' appears twice"),
        (Motors, MOTOR | {"low_mV": -20.0, "high_mV": -60.0}, "low_mV must be below high_mV"),
        (Motors, MOTOR | {"channels": (X | {"origin": 0.1},)}, "no origin"),
    ],
)
def test_refuses_a_mapping_that_cannot_be(model, fields, problem):
    with pytest.raises(ValidationError, match=problem):
        model(**fields)


def test_a_circuit_with_a_neuron_for_backward_gets_the_motors_for_it():
    assert parking_policy(load_circuit("four_dof")).motors == four_dof_motors()
    assert parking_policy(load_circuit("parking")).motors == parking_motors()


@pytest.mark.parametrize(
    ("name", "downward"),
    [("parking", ()), ("longer", ()), ("mirrored", ("y", "theta")), ("reverse", ("x", "theta"))],
)
def test_sensors_reach_to_the_side_where_the_course_goes(name, downward):
    policy = absolute_policy(load_circuit("parking"), load_course(name))
    assert policy.courses == (name,)
    assert policy.sensing == parking_sensing(downward=downward)
    seen = {"x": 0.3, "y": 0.2, "theta": 0.5, "start": 1.0}
    flipped = [-value if key in downward else value for key, value in seen.items()]
    runner, papers = Runner(policy), Runner(parking_policy(load_circuit("parking")))
    assert runner.tick(flipped) == papers.tick(list(seen.values()))
    assert (runner.potentials == papers.potentials).all()


@pytest.mark.parametrize(
    ("x", "expected"), [(-0.15, -70), (0.0, -70 + 50 * 0.15 / 1.15), (1.0, -20), (2.0, -20)]
)
def test_a_range_begins_at_its_origin(x, expected):
    channel = Channel(name="x", positive="alone", maximum=1.15, origin=-0.15)
    runner = Runner(Policy(UNCONNECTED, Sensing(name="test", inputs=("x",), channels=(channel,)), MOTORS))
    runner.tick([x])
    assert runner.potentials[2] == pytest.approx(expected)


def test_layers_work_on_parts_of_ranges_and_limits():
    policy = course_policy(load_circuit("tap_withdrawal"))
    runner = Runner(policy)
    # Of the first mixture: half of longitudinal's range, and of speed's a quarter at weight 0.6.
    runner.tick([0.1, 0.0, 0.0, 0.04, 0.0])
    potentials = dict(zip(policy.circuit.neurons, runner.potentials, strict=True))
    assert potentials["PLM"] == pytest.approx(-70 + 50 * (0.5 + 0.6 / 4))
    assert potentials["AVM"] == pytest.approx(-70)
    for held, command in (({9: -20.0, 10: -70.0}, (0.24, -0.36)), ({9: -56.0, 10: -56.0}, (0.144, 0.0))):
        loud = replace(policy, circuit=replace(policy.circuit, held=held), output_layer=[[3, 3], [-3, 3]])
        assert Runner(loud).tick([0.0] * 5) == pytest.approx(command)
