"""How long the driver takes from odometry to command: ``rover-ncp bench deploy``.

The driver is the real process, recording as in a drive; odometry comes from a peer that stands in for the
bridge, at the requested rates, and half a period after each sample the same bytes go to a process that sends
them straight back. What the driver adds is its time beyond half of that round trip.
"""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.files import write_atomic
from rover_ncp.course.course import TICK_S, load_course
from sim.benchmarks.peer import BenchPeer, Moments
from sim.live.processes import Process, ProcessError, TimedOut, wait_for
from sim.pioneer.ros2_server import free_port

RATES_HZ = (10.0, 50.0, 100.0)
FASTEST_HZ, FASTEST_S = 500.0, 20.0
P999_SAMPLES = 10_000
CIRCUIT_TICKS, CIRCUIT_REPEATS = 500, 20
START_S, EXTRA_S = 120.0, 60.0


class Quantiles(BaseModel):
    """Quantiles of times."""

    p50: float = Field(description="median")
    p99: float = Field(description="99th percentile")
    max: float = Field(description="largest")
    p99_9: float | None = Field(description="99.9th percentile, from 10,000 samples on")


class Difference(BaseModel):
    """Differences of quantiles."""

    p50: float = Field(description="of the medians")
    p99: float = Field(description="of the 99th percentiles")


class DriveTicks(BaseModel):
    """Ticks of a drive; all but its rate are null if it was not measured."""

    rate_hz: float = Field(description="samples of odometry")
    stopped: str | None = Field(default=None, description="why it was not measured")
    ticks: int | None = Field(default=None, description="steps of control")
    predicted: int | None = Field(default=None, description="ticks without fresh odometry")
    missed: int | None = Field(default=None, description="ticks that did not run")
    tick_rate_hz: float | None = Field(default=None, description="reached over the whole drive")
    cpu_share: float | None = Field(default=None, description="of a core")


class RateResult(DriveTicks):
    """Ticks and delays of a drive; null if it was not measured."""

    samples: int | None = Field(default=None, description="commands that were timed")
    odometry_to_command_ms: Quantiles | None = Field(
        default=None, description="from a sample's sending until the driver hands its command over"
    )
    bare_half_round_trip_ms: Quantiles | None = Field(
        default=None, description="of the same bytes between two bare processes"
    )
    above_bare_ms: Difference | None = Field(default=None, description="their difference")
    tick_jitter_ms: Quantiles | None = Field(
        default=None, description="intervals between commands against the period"
    )


class BenchResult(BaseModel):
    """Result of the command ``bench deploy``."""

    cores: int | None = Field(description="that the machine has")
    load_before: float = Field(description="load average of a minute")
    circuit_us: float = Field(description="of a tick, median CPU time")
    rates: list[RateResult] = Field(description="of 10, 50 and 100 Hz")
    fastest: DriveTicks = Field(description="when 500 Hz are requested")
    load_after: float = Field(description="load average of a minute")


def bench_deploy(seconds: float, say: Callable[[str], None]) -> BenchResult:
    """Measure at each rate for so many seconds. A drive that fails or is stopped costs its rate alone."""
    load_before, circuit_us = os.getloadavg()[0], _circuit_us()
    say(f"the circuit takes {circuit_us:.1f} µs a tick")
    rates = []
    for rate_hz in RATES_HZ:
        measured = _try_rate(rate_hz, seconds, say, ping=True)
        rates.append(measured)
        ours, bare = measured.odometry_to_command_ms, measured.bare_half_round_trip_ms
        if ours is None or bare is None:
            continue
        say(
            f"{rate_hz:.0f} Hz: {ours.p50:.2f} ms from odometry to command (99 %: {ours.p99:.2f} ms); "
            f"bare half round trip {bare.p50:.2f} and {bare.p99:.2f} ms; {measured.cpu_share:.0%} of a core"
        )
    fastest = _try_rate(FASTEST_HZ, min(seconds, FASTEST_S), say, ping=False)
    if not fastest.stopped:
        say(
            f"{FASTEST_HZ:.0f} Hz requested: {fastest.tick_rate_hz:.1f} ticks a second, "
            f"{fastest.missed} missed"
        )
    return BenchResult(
        cores=os.cpu_count(),
        load_before=load_before,
        circuit_us=circuit_us,
        rates=rates,
        fastest=DriveTicks.model_validate(fastest.model_dump()),
        load_after=os.getloadavg()[0],
    )


def quantiles(times_ms: Sequence[float] | NDArray[np.float64]) -> Quantiles:
    """Return quantiles; 99.9 % where there are enough samples."""
    p50, p99, p99_9 = np.percentile(times_ms, [50, 99, 99.9]).tolist()
    enough = len(times_ms) >= P999_SAMPLES
    return Quantiles(p50=p50, p99=p99, max=float(np.max(times_ms)), p99_9=p99_9 if enough else None)


def _try_rate(rate_hz: float, seconds: float, say: Callable[[str], None], *, ping: bool) -> RateResult:
    """Measure at a rate; on a busy machine a safety rule may stop the drive."""
    try:
        return _measure(rate_hz, seconds, ping=ping)
    except (ProcessError, TimedOut) as error:
        say(f"{rate_hz:.0f} Hz: not measured: {error}")
        return RateResult(rate_hz=rate_hz, stopped=str(error))


def _measure(rate_hz: float, seconds: float, *, ping: bool) -> RateResult:
    ticks, module = round(seconds * rate_hz), "sim.benchmarks.programs"
    with tempfile.TemporaryDirectory() as name, ExitStack() as running:
        folder = Path(name)
        course = _course(folder, ticks)
        peer = BenchPeer(free_port("127.0.0.1"), rate_hz, ping)
        running.callback(peer.close)
        echo = running.enter_context(Process("echo", [peer.robot], folder, module))
        echo.wait_for_line("ready")
        peer.start()
        arguments = [peer.robot, str(course), str(folder / "run.mcap"), str(1.0 / rate_hz)]
        driver = running.enter_context(Process("deploy", arguments, folder, module))
        wait_for(lambda: not driver.running or peer.moments.commands, START_S, "the driver's first command")
        cpu_s = [(_cpu_s(driver.pid), time.monotonic())]
        while driver.running and len(peer.moments.commands) < ticks - 1:
            cpu_s.append((_cpu_s(driver.pid), time.monotonic()))
            time.sleep(0.02)
        done = driver.wait(EXTRA_S)
        if done.code not in {0, 1}:
            raise driver.failure()
    drive = done.result
    return RateResult(
        rate_hz=rate_hz,
        **{field: drive[field] for field in ("ticks", "predicted", "missed", "tick_rate_hz")},
        cpu_share=(cpu_s[-1][0] - cpu_s[0][0]) / (cpu_s[-1][1] - cpu_s[0][1]),
        **(latencies(peer.moments, rate_hz) if ping else {}),
    )


def latencies(moments: Moments, rate_hz: float) -> dict[str, Any]:
    """Return delays in ms of each command after the newest odometry before it, beside half of each ping."""
    commands = np.array(moments.commands[: len(moments.commands) - 1])  # the last one only says stop
    sent = np.array(moments.odometry)
    newest = sent[np.searchsorted(sent, commands) - 1]
    ours = quantiles((commands - newest) / 1e6)
    pairs = min(len(moments.pings), len(moments.pongs))
    bare = quantiles((np.array(moments.pongs[:pairs]) - np.array(moments.pings[:pairs])) / 2e6)
    jitter = np.abs(np.diff(commands) - 1e9 / rate_hz) / 1e6
    return {
        "samples": len(commands),
        "odometry_to_command_ms": ours,
        "bare_half_round_trip_ms": bare,
        "above_bare_ms": Difference(p50=ours.p50 - bare.p50, p99=ours.p99 - bare.p99),
        "tick_jitter_ms": quantiles(jitter),
    }


def _circuit_us() -> float:
    """Return the median CPU time of a tick of the shipped circuit, called as the driver calls it."""
    runner, seen = Runner(load_policy("parking")), np.array([0.3, 0.3, 0.3, 1.0])
    runner.tick(seen)
    times = []
    for _ in range(CIRCUIT_REPEATS):
        began = time.thread_time()
        for _ in range(CIRCUIT_TICKS):
            runner.tick(seen)
        times.append((time.thread_time() - began) / CIRCUIT_TICKS)
    return float(np.median(times)) * 1e6


def _course(folder: Path, ticks: int) -> Path:
    """Write the parking course with as many ticks and a start signal that never comes.

    So the rover stands, and has nothing to do with a time that runs faster than it could follow.
    """
    parking = load_course("parking")
    horizon_s = max(round(ticks * TICK_S, 1), parking.horizon_s)
    course = parking.model_copy(update={"start_signal_s": horizon_s, "horizon_s": horizon_s})
    path = folder / "course.yaml"
    write_atomic(path, dump_yaml(course.model_dump(mode="json")))
    return path


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process so far."""
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)
