"""The benchmark of the driver, with real processes: that it measures what it says, not how fast it is."""

import pytest

from sim.benchmarks import deploy as bench_deploy

pytestmark = pytest.mark.timed


def test_it_measures_the_driver(run_json, monkeypatch):
    monkeypatch.setattr(bench_deploy, "RATES_HZ", (100.0,))
    monkeypatch.setattr(bench_deploy, "CIRCUIT_REPEATS", 2)
    code, found = run_json("bench deploy --seconds 3")
    assert code == 0
    assert found["circuit_us"] > 0.0
    (rate,) = found["rates"]
    assert rate["ticks"] + rate["missed"] == 320  # the course is no shorter than that
    assert rate["samples"] == rate["ticks"]
    assert 0.0 < rate["odometry_to_command_ms"]["p50"] <= rate["odometry_to_command_ms"]["p99"]
    assert 0.0 < rate["cpu_share"] < 2.0
