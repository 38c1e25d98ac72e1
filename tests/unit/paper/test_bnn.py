"""Published circuits, converted into policies and circuits of this project."""

import shutil

import pytest
from kit.paths import DATA

from paper.bnn import convert, load_bnn
from rover_ncp.circuit.motors import parking_motors
from rover_ncp.circuit.policy_file import (
    policy_from_yaml,
    policy_to_yaml,
)
from rover_ncp.circuit.runner import Runner
from rover_ncp.circuit.sensing import parking_sensing
from rover_ncp.core.errors import ConfigError, FileError

GOLDEN = DATA / "golden"


def test_published_circuit_is_converted_once(tmp_path):
    out = tmp_path / "parking.yaml"
    convert(GOLDEN / "parking.bnn", out)
    assert out.read_text() == policy_to_yaml(load_bnn(GOLDEN / "parking.bnn"))
    with pytest.raises(FileError, match="--overwrite"):
        convert(GOLDEN / "parking.bnn", out)


def test_bnn_drives_with_sensors_that_are_not_clamped():
    policy = load_bnn(GOLDEN / "parking.bnn")
    assert policy.sensing == parking_sensing(clamp=False)
    assert policy.motors == parking_motors()
    assert policy.circuit.weight[0] == 1.55348
    assert policy.circuit.capacitance[11] == 0.00146423


def test_thirteenth_neuron_of_published_files_is_idle(tmp_path):
    text = (GOLDEN / "parking.bnn").read_text()
    path = tmp_path / "thirteen.bnn"
    path.write_text(text.replace("size 12", "size 13"))
    thirteen, twelve = Runner(load_bnn(path)), Runner(load_bnn(GOLDEN / "parking.bnn"))
    for _ in range(5):
        assert thirteen.tick([0.2, 0.3, 0.4, 1.0]) == twelve.tick([0.2, 0.3, 0.4, 1.0])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("cm 0 0.1\n", "line 1: 'cm 0 0.1': size must come first"),
        ("size 2\nfoo 1\n", "line 2: 'foo 1': unknown statement"),
        ("size 2\n\n# x\ncm 2 0.1\n", "line 4: 'cm 2 0.1': neuron 2 is not in 0..1"),
        ("size 2\nex 0 1\n", "line 2: 'ex 0 1': "),
        ("size 2\ncm 0 nan\n", "PVD"),
        ("# nothing\n", "no size statement"),
        ("size 2\nconst 0 20\n", "PVD: held at 20 mV, outside -90..0 mV"),
        ("size 2\nex 0 1 1\nex 0 1 2\n", "the synapse excitatory PVD -> PLM appears twice"),
    ],
)
def test_bad_bnn_is_one_line_with_the_line_number(text, problem, tmp_path):
    path = tmp_path / "bad.bnn"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_bnn(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert problem in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("my circuit", "my-circuit"),
        ("x" * 100, "x" * 64),
        ("日本", "circuit"),
    ],
)
def test_policy_of_any_bnn_file_is_read_from_what_is_written(tmp_path, stem, name):
    path = tmp_path / f"{stem}.bnn"
    shutil.copy(GOLDEN / "parking.bnn", path)
    policy = load_bnn(path)
    assert policy.circuit.name == name
    assert policy_from_yaml(policy_to_yaml(policy), "again").circuit.name == name
