"""Circuits of files on the paper's benchmarks: ``eval --task``."""

import pytest
from kit.bnn_text import circuit_to_bnn
from kit.paths import ROOT

from rover_ncp.circuit.policy_file import circuit_to_yaml
from sim.paper.interpretation import best_circuit
from sim.paper.interpretation import trained as trained_policy
from sim.paper.results import ResultStore


@pytest.fixture(scope="module")
def trained():
    """Return the best shipped mountain-car run and its circuit."""
    result = best_circuit(ResultStore(ROOT / "results"), "mountain-car")
    return result, trained_policy(result).circuit


def test_a_published_circuit_plays_its_benchmark(trained, tmp_path, run_json):
    result, circuit = trained
    bnn, yaml = tmp_path / "car.bnn", tmp_path / "car.yaml"
    bnn.write_text(circuit_to_bnn(circuit))
    yaml.write_text(circuit_to_yaml(circuit))
    code, clamped = run_json(f"eval {yaml} --task mountain-car")
    assert code == 0
    assert clamped["return"] == pytest.approx(result.mean, abs=3.0)  # other episodes of the same circuit
    assert clamped["ranges"] == {"position": 1.0, "velocity": 0.02}
    _, unclamped = run_json(f"eval {bnn} --task mountain-car")
    assert unclamped["return"] != clamped["return"]  # a velocity beyond its range is seen as it is


def test_a_sensors_range_matters_and_can_be_given(trained, tmp_path, run_json):
    path = tmp_path / "car.bnn"
    path.write_text(circuit_to_bnn(trained[1]))
    command = f"eval {path} --task mountain-car"
    assert run_json(f"{command} --trials 5 --range position=1.0") == run_json(f"{command} --trials 5")
    code, blind = run_json(f"{command} --trials 1 --range position=1000 --range velocity=1000")
    assert (code, blind["success"], blind["ranges"]["velocity"]) == (1, False, 1000.0)
