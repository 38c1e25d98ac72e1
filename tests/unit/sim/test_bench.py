"""The benchmarks at a size that takes seconds: what they count must be what happened."""

import csv
import importlib

import pytest
from kit.paths import ROOT

from benchmarks import search as bench_search
from sim.benchmarks import deploy as bench_deploy
from sim.learn.agents import AgentState, Batch
from sim.learn.record import TrainSettings, resolve_task
from sim.learn.train import training_plan
from sim.live.processes import ProcessError


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_benchmark_is_imported_and_prints_its_help(path, monkeypatch, capsys):
    module = importlib.import_module(f"benchmarks.{path.stem}")
    if hasattr(module, "argparse"):
        monkeypatch.setattr("sys.argv", [path.stem, "--help"])
        with pytest.raises(SystemExit, match=r"^0$"):
            module.main()
        assert capsys.readouterr().out.startswith("usage: ")


def test_the_searches_are_compared_by_what_training_gives(monkeypatch):
    monkeypatch.setattr(bench_search, "available_processes", lambda: 1)
    monkeypatch.setattr(bench_search, "MARKS", (20, 40))
    monkeypatch.setattr(bench_search, "PASSED", (-30.0, -8.0))
    said = []
    rows = csv.DictReader(bench_search.returns_table(4, 3, 60, said.append, ["published"]))
    settings = TrainSettings.model_validate({"seed": 4, "search": "published"})
    batch = Batch(training_plan(settings, resolve_task(settings)))
    agents = [states[-1] for states in batch.advance([AgentState(number) for number in range(3)], [60])]
    for row, agent in zip(rows, agents, strict=True):
        assert row["agent"] == str(agent.number)
        for mark in (20, 40, 60):
            assert float(row[f"after_{mark}"]) == agent.value_at(mark)
    past = [sum(agent.value > level for agent in agents) for level in (-30.0, -8.0)]
    assert said[0].endswith(f"{past[0]} past -30, {past[1]} past -8 of 3")


def test_rates_that_were_measured_are_kept_when_a_safety_rule_stops_another(monkeypatch, run_json):
    def measure(rate_hz, seconds):
        if rate_hz == 50.0:
            raise ProcessError("deploy", 4, "stopped by odometry: it is 0.45 s old")
        drive = {"ticks": 9, "predicted": 0, "missed": 0, "tick_rate_hz": rate_hz, "cpu_share": 0.1}
        times = {"p50": 1.0, "p99": 2.0, "max": 3.0}
        return bench_deploy.RateResult(rate_hz=rate_hz, **drive, odometry_to_command_ms=times)

    monkeypatch.setattr(bench_deploy, "_measure", measure)
    monkeypatch.setattr(bench_deploy, "_circuit_us", lambda: 5.0)
    code, found = run_json("bench deploy")
    assert code == 1
    assert [(rate["rate_hz"], bool(rate["stopped"])) for rate in found["rates"]] == [
        (10.0, False),
        (50.0, True),
        (100.0, False),
    ]
    assert "0.45 s old" in found["rates"][1]["stopped"]
    assert found["rates"][2]["odometry_to_command_ms"]["p99"] == 2.0


def test_a_command_is_compared_with_the_odometry_before_it():
    ms = 1_000_000
    commands, odometry = [1 * ms, 102 * ms, 203 * ms, 304 * ms], [0, 100 * ms, 200 * ms, 300 * ms]
    found = bench_deploy.delays(commands, odometry)
    assert found.p50 == pytest.approx(2.5)
    assert found.max == pytest.approx(4.0)
