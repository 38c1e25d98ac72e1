import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from kit.bnn_text import circuit_to_bnn
from kit.paths import DATA
from kit.wirings import in_bounds, unit_vectors

from rover_ncp.circuit.bnn import circuit_from_bnn
from rover_ncp.circuit.motors import Motors, parking_motors
from rover_ncp.circuit.policy import Policy, parking_policy
from rover_ncp.circuit.policy_file import (
    load_circuit,
    load_policy,
    policy_from_yaml,
    policy_to_yaml,
    save_policy,
)
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import Sensing, parking_sensing
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import ConfigError, FileError

GOLDEN = DATA / "golden"
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
    loaded = circuit_from_bnn(circuit_to_bnn(policy.circuit), policy.circuit.name, "test")
    same(parking_policy(policy.circuit), parking_policy(loaded))


def test_bnn_drives_with_sensors_that_are_not_clamped():
    policy = load_policy(GOLDEN / "parking.bnn")
    assert policy.sensing == parking_sensing(clamp=False)
    assert policy.motors == parking_motors()
    assert policy.circuit.weight[0] == 1.55348
    assert policy.circuit.capacitance[11] == 0.00146423


def test_thirteenth_neuron_of_published_files_is_idle(tmp_path):
    text = (GOLDEN / "parking.bnn").read_text()
    path = tmp_path / "thirteen.bnn"
    path.write_text(text.replace("size 12", "size 13"))
    thirteen, twelve = Runner(load_policy(path)), Runner(load_policy(GOLDEN / "parking.bnn"))
    for _ in range(5):
        assert thirteen.tick([0.2, 0.3, 0.4, 1.0]) == twelve.tick([0.2, 0.3, 0.4, 1.0])


def test_bnn_defaults():
    circuit = circuit_from_bnn("size 3\n# nothing\n\nex 0 1 1.5 # comment\nconst 2 -33\n", "d", "test")
    assert circuit.capacitance.tolist() == [0.05] * 3
    assert circuit.leak.tolist() == [1.0] * 3
    assert circuit.leak_potential.tolist() == [-70.0] * 3
    assert circuit.sigma.tolist() == [0.1]
    assert circuit.held == {2: -33.0}


def test_bnn_without_motor_neurons_is_a_circuit_but_no_policy():
    assert load_circuit(GOLDEN / "tap_withdrawal.bnn").size == 11
    with pytest.raises(
        ConfigError, match=r"tap_withdrawal\.bnn: to drive a rover it needs at least 12 neurons"
    ):
        load_policy(GOLDEN / "tap_withdrawal.bnn")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("cm 0 0.1\n", "line 1: a size statement must come first"),
        ("# only a comment\n", "no size statement"),
        ("size 0\n", "line 1: expected 'size N', N in 1..256, got 'size 0'"),
        ("size\n", "line 1: expected 'size N', N in 1..256, got 'size'"),
        ("size 2\nfoo 1\n", "line 2: unknown statement 'foo'"),
        ("size 2\n\n# x\ncm 2 0.1\n", "line 4: neuron '2' is not in 0..1"),
        ("size 2\ncm 0.5 0.1\n", "line 2: neuron '0.5' is not in 0..1"),
        ("size 2\ncm 0\n", "line 2: expected 'cm neuron value', got 1 values"),
        ("size 2\ncm 0 nan\n", "line 2: expected a number, got 'nan'"),
        ("size 2\nconst 0 20\n", "PVD: held at 20 mV, outside -90..0 mV"),
        ("size 2\nex 0 2 1\n", "line 2: neuron '2' is not in 0..1"),
        ("size 2\nex 0 1 1_0\n", "line 2: expected a number, got '1_0'"),
        ("size 2\ngj 0 1 1 0.1\n", "line 2: expected 'gj source destination weight', got 4 values"),
        ("size 2\nex 0 1 1\nex 0 1 2\n", "the synapse excitatory PVD -> PLM appears twice"),
        ("size 2\ncm 0 0.1\ncm 0 0.1\n", "line 3: cm 0 appears twice"),
        ("size 2\nfoo\nex 5 0 1\n", "gj); line 3: neuron '5' is not in 0..1"),
        ("size 2\n" + "foo\n" * 30, "and 10 more"),
    ],
)
def test_bad_bnn_is_one_line_with_the_line_number(text, problem, tmp_path):
    path = tmp_path / "bad.bnn"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_circuit(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert problem in message
    assert "\n" not in message


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
        ([((*NEURON, "name"), "PVD")], ["$.circuit.synapses[4].source: there is no neuron 'AVD'"]),
        ([((*SYNAPSE, "source"), "XYZ")], ["$.circuit.synapses[2].source: there is no neuron 'XYZ'"]),
        ([((*SYNAPSE, "sigma"), None)], ["$.circuit.synapses[2]: a chemical synapse needs sigma"]),
        ([((*SYNAPSE, "sigma"), 0.0)], ["sigma 0 is outside 0.05"]),
        ([((*SYNAPSE, "kind"), "gap")], ["$.circuit.synapses[2]: a chemical synapse needs sigma"]),
        ([((*SYNAPSE, "kind"), "magic")], ["$.circuit.synapses[2].kind: input should be 'excitatory'"]),
        ([(("input_layer",), [[1.0]])], ["$.input_layer: needs 4 rows of 4 numbers, got the shape (1, 1)"]),
        ([(("input_layer",), [[1.0], [1.0, 2.0]])], ["$.input_layer: all rows must have the same length"]),
        (
            [((*NEURON, "leak"), 5.5), ((*SYNAPSE, "weight"), -1)],
            ["$.circuit: AVD: leak 5.5 is outside 0.05..5 S", "weight -1 is outside"],
        ),
        (
            [((*NEURON, "leak"), "much"), ((*SYNAPSE, "weight"), None), (("substeps",), "ten")],
            ["neurons[3].leak", "synapses[2].weight", "$.substeps"],
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


def test_a_missing_or_empty_file(tmp_path):
    for name, problem in {"none.yaml": "no such file", "a.bnn": "is empty", "a.yaml": "is empty"}.items():
        if name != "none.yaml":
            (tmp_path / name).write_text(" \n")
        for load in (load_policy, load_circuit):
            with pytest.raises(FileError, match=f"{name}: .*{problem}"):
                load(tmp_path / name)


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("my circuit", "my-circuit"),
        ("größe", "groe"),
        ("bi\u202edi", "bidi"),
        ("x" * 100, "x" * 64),
        ("日本", "circuit"),
        ("-..+", "circuit"),
        ("new\nline", "new-line"),
        ("\udcff", "circuit"),
        ("v1.2_a+b-c", "v1.2_a+b-c"),
    ],
)
def test_policy_of_any_bnn_file_is_read_from_what_is_written(tmp_path, stem, name):
    path = tmp_path / f"{stem}.bnn"
    shutil.copy(GOLDEN / "parking.bnn", path)
    policy = load_policy(path)
    assert policy.circuit.name == load_circuit(path).name == name
    assert policy_from_yaml(policy_to_yaml(policy), "again").circuit.name == name


@pytest.mark.parametrize("name", ["", "a b", "ä", "x" * 65, "\u202ea", "*/", "-a", "1\n"])
def test_name_that_no_file_can_hold_is_refused_where_it_is_made(name):
    circuit = load_circuit("parking")
    for changes in ({"name": name}, {"neurons": (name, *circuit.neurons[1:])}):
        with pytest.raises(ConfigError, match="expected letters, digits"):
            replace(circuit, **changes)


def test_text_that_is_not_utf_8_does_not_stop_a_file():
    assert yaml.safe_load(dump_yaml({"from": "a\udcff"})) == {"from": "a\ufffd"}
