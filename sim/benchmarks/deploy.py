"""How long the driver takes from odometry to command: ``rover-ncp bench deploy``.

The driver is the real process, recording as in a drive; odometry comes from a peer that stands in for the
bridge, at the requested rates.
"""

import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import psutil
from pydantic import BaseModel, Field

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.files import write_atomic
from rover_ncp.course.course import TICK_S, load_course
from sim.benchmarks.peer import BenchPeer
from sim.live.processes import Process, ProcessError, TimedOut, wait_for
from sim.mock.ros2_server import free_port

RATES_HZ = (10.0, 50.0, 100.0)
CIRCUIT_TICKS, CIRCUIT_REPEATS = 500, 20
START_S, EXTRA_S = 120.0, 60.0


class Quantiles(BaseModel):
    """Quantiles of times."""

    p50: float = Field(description="median")
    p99: float = Field(description="99th percentile")
    max: float = Field(description="largest")


class RateResult(BaseModel):
    """Ticks and delays of a drive; all but its rate are null if it was not measured."""

    rate_hz: float = Field(description="samples of odometry")
    stopped: str | None = Field(default=None, description="why it was not measured")
    ticks: int | None = Field(default=None, description="steps of control")
    predicted: int | None = Field(default=None, description="ticks without fresh odometry")
    missed: int | None = Field(default=None, description="ticks that did not run")
    tick_rate_hz: float | None = Field(default=None, description="reached over the whole drive")
    cpu_share: float | None = Field(default=None, description="of a core")
    samples: int | None = Field(default=None, description="commands that were timed")
    odometry_to_command_ms: Quantiles | None = Field(
        default=None, description="from a sample's sending until the driver hands its command over"
    )


class BenchResult(BaseModel):
    """Result of the command ``bench deploy``."""

    cores: int | None = Field(description="that the machine has")
    load_before: float = Field(description="load average of a minute")
    circuit_us: float = Field(description="of a tick, median CPU time")
    rates: list[RateResult] = Field(description="of 10, 50 and 100 Hz")
    load_after: float = Field(description="load average of a minute")


def bench_deploy(seconds: float, say: Callable[[str], None]) -> BenchResult:
    """Measure at each rate for so many seconds. A drive that fails or is stopped costs its rate alone."""
    load_before, circuit_us = os.getloadavg()[0], _circuit_us()
    say(f"the circuit takes {circuit_us:.1f} µs a tick")
    rates = []
    for rate_hz in RATES_HZ:
        measured = _try_rate(rate_hz, seconds, say)
        rates.append(measured)
        if delay := measured.odometry_to_command_ms:
            say(
                f"{rate_hz:.0f} Hz: {delay.p50:.2f} ms from odometry to command (99 %: {delay.p99:.2f} ms); "
                f"{measured.cpu_share:.0%} of a core"
            )
    return BenchResult(
        cores=os.cpu_count(),
        load_before=load_before,
        circuit_us=circuit_us,
        rates=rates,
        load_after=os.getloadavg()[0],
    )


def _try_rate(rate_hz: float, seconds: float, say: Callable[[str], None]) -> RateResult:
    """Measure at a rate; on a busy machine a safety rule may stop the drive."""
    try:
        return _measure(rate_hz, seconds)
    except (ProcessError, TimedOut) as error:
        say(f"{rate_hz:.0f} Hz: not measured: {error}")
        return RateResult(rate_hz=rate_hz, stopped=str(error))


def _measure(rate_hz: float, seconds: float) -> RateResult:
    ticks = round(seconds * rate_hz)
    with tempfile.TemporaryDirectory() as name, ExitStack() as running:
        folder = Path(name)
        course = _course(folder, ticks)
        peer = BenchPeer(free_port("127.0.0.1"), rate_hz)
        running.callback(peer.close)
        peer.start()
        arguments = [peer.robot, str(course), str(folder / "run.mcap"), str(1.0 / rate_hz)]
        driver = running.enter_context(Process("deploy", arguments, folder, "sim.benchmarks.driver"))
        wait_for(lambda: not driver.running or peer.moments.commands, START_S, "the driver's first command")
        cpu_s = [(_cpu_s(driver.pid), time.monotonic())]
        while driver.running and len(peer.moments.commands) < ticks - 1:
            cpu_s.append((_cpu_s(driver.pid), time.monotonic()))
            time.sleep(0.02)
        done = driver.wait(EXTRA_S)
        if done.code not in {0, 1}:
            raise driver.failure()
    commands = peer.moments.commands[: len(peer.moments.commands) - 1]  # the last one only says stop
    drive = done.result
    return RateResult(
        rate_hz=rate_hz,
        **{field: drive[field] for field in ("ticks", "predicted", "missed", "tick_rate_hz")},
        cpu_share=(cpu_s[-1][0] - cpu_s[0][0]) / (cpu_s[-1][1] - cpu_s[0][1]),
        samples=len(commands),
        odometry_to_command_ms=delays(commands, peer.moments.odometry),
    )


def delays(commands: list[int], odometry: list[int]) -> Quantiles:
    """Return the delay of each command after the newest odometry before it; moments are in ns."""
    sent, handed_over = np.array(odometry), np.array(commands)
    delays_ms = (handed_over - sent[np.searchsorted(sent, handed_over) - 1]) / 1e6
    p50, p99 = np.percentile(delays_ms, [50, 99]).tolist()
    return Quantiles(p50=p50, p99=p99, max=float(delays_ms.max()))


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
