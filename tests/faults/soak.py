"""Soak test: inject every row of the safety matrix at random moments, in processes that keep running.

Mock and bridge run from beginning to end, so that leaks show. The rows come in a random order, each once
before any comes again. Killing the bridge comes last, as it ends the long-running process. The seed decides
the order, the drivers and how long the rover moves before each fault. Times depend on the machine.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zenoh
from kit.paths import DATA

from faults.going_on import SILENT_CLOSE_ROW
from faults.losses import Completeness, Usage, check_recording, leaks, usage
from faults.measure import Measured, measure
from faults.rig import Rig
from faults.row import CIRCUIT, Row
from faults.table import MATRIX
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.streams import Domain, random_stream
from sim.live.processes import compile_driver, wait_for

LAST = "bridge-killed"
ROUND_S, LAST_S = 15.0, 25.0
"""The usual upper bound of a round, and that of the last round with the end of the soak."""
COURSE = DATA / "prompt_course.yaml"
QUIET_S = 1.0
STILL_S = 2.0
"""How long the rover must stand at the end."""


@dataclass
class Round:
    """One fault: its time (s since the start), and its measurement or failure."""

    at_s: float
    row: Row
    driver: str
    measured: Measured | None
    failure: str = ""

    @property
    def passed(self) -> bool:
        """Whether the rover stopped in time, stayed stopped, and its driver reported the stop."""
        return self.measured is not None and self.measured.in_time

    def __str__(self) -> str:
        clock = f"{self.at_s // 60:3.0f}:{self.at_s % 60:02.0f}"
        where, found = f"{clock}  {self.row.layer}: {self.row.fault} ({self.driver})", self.measured
        if found is None:
            return f"{where}: FAILED: {self.failure}"
        late, allowed_s = "" if found.in_time else "TOO LATE, ", found.bound_s + found.braking_s
        return f"{where}: {late}stood after {found.seconds:.2f} s of {allowed_s:.2f} s"


@dataclass
class Soaked:
    """Results of a soak."""

    rounds: list[Round] = field(default_factory=list)
    recordings: list[Completeness] = field(default_factory=list)
    usage: dict[str, list[Usage]] = field(default_factory=lambda: {"bridge": [], "mock": []})
    settled: int = 0
    """The number of rounds after which every row that leaves the first processes running came once."""
    not_reached: list[Row] = field(default_factory=list)
    still: bool = False
    wall_s: float = 0.0
    load: float = 0.0
    """The highest load average of a minute."""

    def failed(self) -> list[str]:
        """Return every failed check in words; empty when all passed."""
        wrong = [str(done).strip() for done in self.rounds if not done.passed]
        wrong += [
            f"{name} leaks: {each}"
            for name, samples in self.usage.items()
            for each in leaks(samples, self.settled)
        ]
        wrong += [
            f"{each.path.name}: lost {each.missing} samples, {each.gaps} SIPs, {each.skipped} commands"
            for each in self.recordings
            if each.lost
        ]
        return wrong if self.still else [*wrong, "the rover does not stand in the end"]

    def table(self) -> Iterator[tuple[str, ...]]:
        """Yield head and rows: how often each fault occurred, and the time with the least margin."""
        yield "layer", "fault", "times", "slowest standstill after", "allowed"
        for row in MATRIX:
            rounds = [done for done in self.rounds if done.row == row]
            found = [done.measured for done in rounds if done.measured is not None]
            head = row.layer, row.fault, str(len(rounds))
            if found:
                worst = max(found, key=lambda each: each.seconds - each.braking_s)
                allowed = f"{worst.bound_s:g} s + {worst.braking_s:.2f} s braking"
                yield *head, f"{worst.seconds:.2f} s", allowed
            elif rounds:
                yield *head, "failed", ""


def soak(
    seconds: float,
    seed: int,
    folder: Path,
    on_round: Callable[[Round], None],
    rows: Sequence[Row] = MATRIX,
) -> Soaked:
    """Inject faults for ``seconds``; call ``on_round`` at the end of each round.

    Recordings, logs and the mock's truth go to ``folder``. Raises RoverNcpError when the processes do not
    start or the rover cannot be driven at the end.
    """
    compile_driver()  # else the compilation would delay the first round
    order, moments = (random_stream(seed, domain) for domain in (Domain.SOAK_ORDER, Domain.SOAK_MOMENTS))
    soaked, began_s = Soaked(), time.monotonic()
    # One bridge runs from beginning to end, and its clock stamps what recordings are compared with.
    rows = [row for row in rows if row.act and row.layer != "clock" and row is not SILENT_CLOSE_ROW]
    last = [row for row in rows if row.key == LAST]
    with Rig(folder / "log", COURSE) as rig:

        def inject(row: Row, driver: str) -> None:
            soaked.load = max(soaked.load, os.getloadavg()[0])
            at_s = time.monotonic() - began_s
            record = folder / "drives" / f"{len(soaked.rounds) + 1:03d}-{row.key}.mcap"
            measured, failure = None, ""
            try:
                measured = _measured(rig, row, driver, record, moments)
            except (RoverNcpError, zenoh.ZError) as error:
                failure = str(error)
            soaked.rounds.append(Round(at_s, row, driver, measured, failure))
            if record.exists() and measured is not None:
                soaked.recordings.append(_complete(record, rig.watcher.odometry_ns, measured))
            _settle(rig)
            for name, process in (("bridge", rig.bridge), ("mock", rig.mock)):
                if row.key != LAST:
                    soaked.usage[name].append(usage(process.pid, time.monotonic() - began_s))
            on_round(soaked.rounds[-1])

        soaked.settled = len(rows) - len(last)
        plan = _plan([row for row in rows if row.key != LAST], order)
        while time.monotonic() - began_s + ROUND_S + LAST_S * len(last) < seconds:
            inject(*next(plan))
        for row in last:
            inject(row, CIRCUIT)
        rig.end(rig.under_way(rig.scripted_driver()))
        rig.stood(time.monotonic_ns())
        stands_ns = time.monotonic_ns()
        time.sleep(STILL_S)
        soaked.still = not any(state.moving for state in rig.truth.since(stands_ns))
    soaked.wall_s = time.monotonic() - began_s
    reached = {each.row for each in soaked.rounds}
    soaked.not_reached = [row for row in rows if row not in reached]
    return soaked


def _plan(rows: Sequence[Row], order: np.random.Generator) -> Iterator[tuple[Row, str]]:
    """Yield rows and drivers without end: all rows once in random order, then again in another order."""
    while True:
        for place in order.permutation(len(rows)):
            drivers = rows[place].drivers
            yield rows[place], drivers[int(order.integers(len(drivers)))]


def _measured(rig: Rig, row: Row, driver: str, record: Path, moments: np.random.Generator) -> Measured:
    """Measure a row. One that blocks the bridge's output for good gets a mock and a bridge of its own."""
    if not row.outlet:
        return measure(rig, row, driver, record, moments)
    with Rig(rig.folder / record.stem, rig.course, outlet=row.outlet) as own:
        return measure(own, row, driver, record, moments)


def _complete(record: Path, received_ns: Sequence[int], measured: Measured) -> Completeness:
    killed, losing = measured.stopped_by == "killed", measured.row.layer in {"deploy", "link", "bridge"}
    try:
        return check_recording(record, received_ns, measured.began_ns, killed=killed, losing=losing)
    except RoverNcpError:
        return Completeness(record, False, 0, 1, 0, 0)


def _settle(rig: Rig) -> None:
    """Remove the faults that a failed round left, and wait until no driver has the lease."""
    rig.link.tell("release")
    rig.line.tell("release")
    rig.bridge.send_signal(signal.SIGCONT)
    if not rig.bridge.running:
        rig.start_bridge()
    with suppress(RoverNcpError):
        wait_for(
            lambda: not rig.watcher.gate.held and not rig.watcher.gate.lease,
            what="the gate to be ready again",
        )
    time.sleep(QUIET_S)
