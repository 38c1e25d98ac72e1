"""Lesions of trained circuits."""

import json
from pathlib import Path

import numpy as np

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.cli import run
from sim.paper.lesions import INTACT, lesion_study, lesioned
from sim.paper.results import ResultStore
from sim.paper.tasks import TASKS

SHIPPED = ResultStore(Path("nowhere"))


def test_a_lesion_takes_out_all_that_touches_a_neuron_and_nothing_else():
    task = TASKS["cart-pole"]
    policy = task.policy(task.circuit())
    vector = SHIPPED.results("cart-pole", "circuit")[0].parameters.array()
    circuit = policy.circuit
    found = lesioned(policy, vector)
    assert len(found) == 1 + circuit.size + circuit.synapse_count
    assert found[INTACT].tolist() == vector.tolist()
    weights = policy.layout().block(ParameterKind.WEIGHT).slice
    outside = np.ones(len(vector), bool)
    outside[weights] = False
    changed = {name: np.flatnonzero(other[weights] != vector[weights]) for name, other in found.items()}
    assert all((other[outside] == vector[outside]).all() for other in found.values())
    ava = circuit.index("AVA")
    touching = np.flatnonzero((circuit.source == ava) | (circuit.destination == ava))
    assert set(changed["AVA"]) <= set(touching)
    assert not found["AVA"][weights][touching].any()
    assert all(len(changed[circuit.label(index)]) <= 1 for index in range(circuit.synapse_count))


def test_a_circuit_without_its_motor_neurons_does_not_park():
    rows = {row["part"]: row for row in lesion_study(SHIPPED, ["parking"])}
    assert (rows[INTACT]["succeed"], rows[INTACT]["circuits"]) == (10, 10)
    assert rows["FWD"]["succeed"] == rows["LFT"]["succeed"] == 0
    assert rows["FWD"]["mean"] < rows[INTACT]["mean"]


def test_the_command_writes_a_picture_and_the_figures(tmp_path, capsys):
    out = tmp_path / "lesions.png"
    assert run(["paper", "lesions", "--task", "parking", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["picture"] == str(out)
    assert len(found["lesions"]) == 1 + 12 + 30
    assert out.read_bytes().startswith(b"\x89PNG")
