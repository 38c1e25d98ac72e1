import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from kit.wirings import in_bounds, unit_vectors

from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import (
    load_circuit,
    load_policy,
    policy_from_yaml,
    policy_to_yaml,
    save_policy,
)
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.circuit.sensing import Sensing, parking_sensing
from rover_ncp.core.errors import ConfigError

PLAIN = replace(parking_policy(load_circuit("parking")), provenance={"seed": 3, "command": "train --seed 3"})
LAYERED = Policy(
    replace(load_circuit("parking"), held={11: -33.3}),
    Sensing(name="layered", inputs=("a", "b"), channels=parking_sensing(False).channels, clamp=False),
    Motors(outputs=("p", "q", "r"), channels=parking_motors().channels, low_mV=-70.0),
    input_layer=np.zeros((4, 2)),
    output_layer=np.zeros((3, 2)),
    dt_s=0.005,
    substeps=20,
    courses=("parking", "other"),
    provenance={"settings": {"alpha": 0.1, "names": ["a", "b"]}, "commit": None},
)


def same(a, b):
    """Assert that two policies are the same to the last bit."""
    assert a.parameters().tobytes() == b.parameters().tobytes()
    for name in ("kind", "source", "destination"):
        np.testing.assert_array_equal(getattr(a.circuit, name), getattr(b.circuit, name))
    for name in ("name", "neurons", "held"):
        assert getattr(a.circuit, name) == getattr(b.circuit, name)
    for name in ("sensing", "motors", "dt_s", "substeps", "courses", "provenance"):
        assert getattr(a, name) == getattr(b, name)


@pytest.mark.parametrize("policy", [PLAIN, LAYERED], ids=["plain", "layered"])
@given(data=st.data())
def test_saved_and_loaded_is_the_same_to_the_last_bit(policy, data, tmp_path_factory):
    policy = policy.with_parameters(in_bounds(policy, data.draw(unit_vectors(policy.layout().size))))
    path = tmp_path_factory.getbasetemp() / "policy.yaml"
    save_policy(path, policy)
    same(policy, load_policy(path))


def edited(*edits):
    """Return the plain policy's YAML with values replaced; an edit is a path and a value (None: removed)."""
    data = yaml.safe_load(policy_to_yaml(PLAIN))
    for path, value in edits:
        place = data
        for key in path[:-1]:
            place = place[key]
        if value is None:
            del place[path[-1]]
        else:
            place[path[-1]] = value
    return yaml.safe_dump(data)


NEURON, SYNAPSE = ("circuit", "neurons", 3), ("circuit", "synapses", 2)


@pytest.mark.parametrize(
    ("edits", "problems"),
    [
        ([(("format",), 2)], ["$.format: input should be 1, got 2"]),
        ([(("surprise",), 1)], ["$.surprise: unknown key"]),
        ([((*NEURON, "leak"), float("nan"))], ["$.circuit.neurons[3].leak: input should be a finite number"]),
        ([((*SYNAPSE, "source"), "XYZ")], ["$.circuit.synapses[2].source: there is no neuron 'XYZ'"]),
        ([((*SYNAPSE, "sigma"), None)], ["$.circuit.synapses[2]: a chemical synapse needs sigma"]),
        ([((*SYNAPSE, "kind"), "magic")], ["$.circuit.synapses[2].kind: input should be 'excitatory'"]),
        ([(("input_layer",), [[1.0]])], ["$.input_layer: needs 4 rows of 4 numbers, got the shape (1, 1)"]),
        (
            [((*NEURON, "leak"), 5.5), ((*SYNAPSE, "weight"), -1)],
            ["$.circuit: AVD: leak 5.5 is outside 0.05..5 S", "weight -1 is outside"],
        ),
    ],
)
def test_bad_policy_is_one_line_with_the_path_of_each_value(edits, problems, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(edited(*edits))
    with pytest.raises(ConfigError) as caught:
        load_policy(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert all(problem in message for problem in problems), message
    assert "\n" not in message


@pytest.mark.parametrize("name", ["", "a b", "x" * 65, "*/"])
def test_name_that_no_file_can_hold_is_refused_where_it_is_made(name):
    circuit = load_circuit("parking")
    for changes in ({"name": name}, {"neurons": (name, *circuit.neurons[1:])}):
        with pytest.raises(ConfigError, match="expected letters, digits"):
            replace(circuit, **changes)


def test_unknown_outputs_are_answered_with_the_known_ones():
    named = policy_to_yaml(load_policy("parking")).replace("name: omega", "name: left")
    policy = policy_from_yaml(re.sub(r"(outputs.*)\bomega\b", r"\1left", named), "renamed")
    with pytest.raises(ConfigError, match="outputs are v, left; expected v, omega"):
        RoverInterface(policy)
