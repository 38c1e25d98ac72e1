"""The benchmark of the driver, with real processes: that it measures what it says, not how fast it is."""

import json

import numpy as np
import pytest

from rover_ncp.cli import run
from sim.benchmarks import deploy as bench_deploy
from sim.benchmarks.deploy import latencies, quantiles
from sim.benchmarks.peer import Moments

pytestmark = pytest.mark.timed

MS = 1_000_000


def test_it_measures_driver_and_bare_way_and_a_fast_loop(capfd, monkeypatch):
    monkeypatch.setattr(bench_deploy, "RATES_HZ", (100.0,))
    monkeypatch.setattr(bench_deploy, "CIRCUIT_REPEATS", 2)
    assert run(["bench", "deploy", "--seconds", "3", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["circuit_us"] > 0.0
    (rate,) = found["rates"]
    assert rate["ticks"] + rate["missed"] == 320  # the course is no shorter than that
    assert rate["samples"] == rate["ticks"]
    assert 0.0 < rate["odometry_to_command_ms"]["p50"] <= rate["odometry_to_command_ms"]["p99"]
    assert rate["bare_half_round_trip_ms"]["p50"] > 0.0
    assert 0.0 < rate["cpu_share"] < 2.0
    assert found["fastest"]["rate_hz"] == 500.0
    assert found["fastest"]["ticks"] > 0


def test_a_command_is_held_against_the_sample_before_it():
    moments = Moments()
    moments.odometry = [0, 100 * MS, 200 * MS, 300 * MS]
    moments.commands = [1 * MS, 102 * MS, 203 * MS, 304 * MS, 310 * MS]
    moments.pings, moments.pongs = [50 * MS, 150 * MS, 250 * MS], [51 * MS, 152 * MS]
    found = latencies(moments, 10.0)
    assert found["samples"] == 4
    assert found["odometry_to_command_ms"].p50 == pytest.approx(2.5)
    assert found["odometry_to_command_ms"].max == pytest.approx(4.0)
    assert found["bare_half_round_trip_ms"].p50 == pytest.approx(0.75)
    assert found["above_bare_ms"].p50 == pytest.approx(1.75)
    assert found["tick_jitter_ms"].max == pytest.approx(1.0)


@pytest.mark.parametrize(("count", "reported"), [(9_999, False), (10_000, True)])
def test_99_9_percentile_needs_ten_thousand_samples(count, reported):
    assert (quantiles(np.linspace(0.0, 1.0, count)).p99_9 is not None) is reported
