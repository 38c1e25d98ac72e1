"""Lesions and disturbances of trained agents."""

import json
from pathlib import Path

import numpy as np
import pytest

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.cli import run
from sim.learn.search.base import draw_seeds
from sim.paper.agents import build_agent
from sim.paper.disturbance import disturbed_returns
from sim.paper.evaluator import Evaluator
from sim.paper.lesions import INTACT, lesion_study, lesioned
from sim.paper.results import ResultStore
from sim.paper.tasks import TASKS

SHIPPED = ResultStore(Path("nowhere"))


def trained(task, agent="circuit"):
    return SHIPPED.results(task, agent)[0].parameters.array()


def test_a_lesion_takes_out_all_that_touches_a_neuron_and_nothing_else():
    task = TASKS["cart-pole"]
    policy = task.policy(task.circuit())
    vector, circuit = trained("cart-pole"), policy.circuit
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


@pytest.mark.parametrize("agent", ["circuit", "lstm"])
def test_without_a_disturbance_an_episode_is_the_evaluators(agent):
    task, seeds = TASKS["cart-pole"], draw_seeds(3, (), 4)
    vectors = np.tile(trained("cart-pole", agent) * 0.7, (4, 1))
    expected = Evaluator(task, build_agent(task, agent, 0), for_search=True).run(vectors, seeds)[:, 0]
    for undisturbed in (("noise", 0.0), ("delay", 0), ("loss", 0.0)):
        assert disturbed_returns(task, agent, vectors, seeds, undisturbed).tolist() == expected.tolist()


@pytest.mark.parametrize("disturbance", [("noise", 3.0), ("delay", 60), ("loss", 0.99)])
def test_a_strong_disturbance_fells_the_pole(disturbance):
    task, seeds = TASKS["cart-pole"], draw_seeds(3, (), 4)
    vectors = np.tile(trained("cart-pole"), (4, 1))
    assert disturbed_returns(task, "circuit", vectors, seeds, disturbance).mean() < 200.0


def test_the_command_writes_a_picture_and_the_figures(tmp_path, capsys):
    out = tmp_path / "lesions.png"
    assert run(["paper", "lesions", "--task", "parking", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["picture"] == str(out)
    assert len(found["lesions"]) == 1 + 12 + 30
    assert out.read_bytes().startswith(b"\x89PNG")
