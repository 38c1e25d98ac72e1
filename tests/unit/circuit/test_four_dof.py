"""Parking with four degrees of freedom: forward and backward, left and right; sensors to a course's side."""

import pytest

from rover_ncp.circuit.circuit import SynapseKind, build_circuit
from rover_ncp.circuit.motors import four_dof_motors, parking_motors
from rover_ncp.circuit.policy import Policy, PolicyRunner, absolute_policy, parking_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.sensing import Channel, Sensing, parking_sensing
from rover_ncp.circuit.tap_withdrawal import four_dof_circuit, parking_circuit
from rover_ncp.course.course import load_course

MOTORS = ("FWD", "REV", "LFT", "RGT")


def test_each_command_neuron_drives_one_way_and_turns_one_way():
    circuit = four_dof_circuit()
    drives = {
        circuit.neurons[end]: circuit.neurons[start]
        for start, end, kind in zip(circuit.source, circuit.destination, circuit.kind, strict=True)
        if circuit.neurons[end] in MOTORS and kind == SynapseKind.EXCITATORY
    }
    assert drives == {"FWD": "AVB", "LFT": "AVB", "REV": "AVA", "RGT": "AVA"}
    assert (circuit.size, circuit.synapse_count) == (13, 30)
    assert set(circuit.neurons) - set(parking_circuit().neurons) == {"REV"}


def test_the_shipped_file_is_the_table():
    shipped, table = load_circuit("four_dof"), four_dof_circuit()
    assert shipped.neurons == table.neurons
    for name in ("source", "destination", "kind", "weight", "sigma"):
        assert (getattr(shipped, name) == getattr(table, name)).all()


@pytest.mark.parametrize(
    ("potentials", "v", "omega"),
    [
        ((-60, -60, -60, -60), 0.0, 0.0),
        ((-20, -60, -60, -60), 0.16, 0.0),
        ((-60, -20, -60, -60), -0.16, 0.0),
        ((-60, -20, -60, -20), -0.16, -0.18),
        ((-20, -20, -20, -20), 0.0, 0.0),
        ((-20, -40, -60, -30), 0.08, -0.135),
        ((-90, 0, 0, -90), -0.16, 0.18),
    ],
)
def test_motor_outputs(potentials, v, omega):
    circuit = build_circuit("held", ("S", *MOTORS), ())
    object.__setattr__(circuit, "held", dict(enumerate(map(float, potentials), 1)))
    sensing = Sensing(name="test", inputs=("x",), channels=(Channel(name="x", positive="S", maximum=1.0),))
    outputs = PolicyRunner(Policy(circuit, sensing, four_dof_motors())).tick([0.0])
    assert outputs == pytest.approx((v, omega), abs=1e-12)


def test_a_circuit_with_a_neuron_for_backward_gets_the_motors_for_it():
    assert parking_policy(four_dof_circuit()).motors == four_dof_motors()
    assert parking_policy(parking_circuit()).motors == parking_motors()


@pytest.mark.parametrize(
    ("name", "downward"),
    [
        ("parking", ()),
        ("longer", ()),
        ("mirrored", ("y", "theta")),
        ("reverse", ("x", "theta")),
    ],
)
def test_sensors_reach_to_the_side_where_the_course_goes(name, downward):
    policy = absolute_policy(parking_circuit(), load_course(name))
    assert policy.courses == (name,)
    assert policy.sensing == parking_sensing(downward=downward)
    seen = {"x": 0.3, "y": 0.2, "theta": 0.5, "start": 1.0}
    flipped = [-value if key in downward else value for key, value in seen.items()]
    runner, papers = PolicyRunner(policy), PolicyRunner(parking_policy(parking_circuit()))
    assert runner.tick(flipped) == papers.tick(list(seen.values()))
    assert (runner.potentials == papers.potentials).all()
