"""Soak: inject every row of the safety matrix at random moments, in processes that keep running.

    make soak                                                   # 20 minutes, seed 0
    PYTHONPATH=tests python -m faults.soak --minutes 20 --seed 1

Mock and bridge run from beginning to end, so that leaks show. The rows come in a random order, each once
before any comes again. Killing the bridge comes last, as it ends the long-running process. After each fault
the rover drives again, and at the end it must stand still. The seed decides the order, the drivers and how
long the rover moves before each fault. Times depend on the machine. All rows need about ten minutes; a short
soak names those that it did not reach.
"""

import argparse
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
import psutil
import zenoh
from kit.paths import DATA
from kit.true_motion import moving, states_since

from faults.going_on import SILENT_CLOSE_ROW
from faults.measure import Measured, measure
from faults.rig import Rig
from faults.row import CIRCUIT, Row
from faults.table import MATRIX
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.streams import Domain, random_stream
from sim.park.live import wait_for

OUT = Path("runs/soak")
"""Logs; those of an earlier soak are deleted."""
LAST = "bridge-killed"
ROUND_S, LAST_S = 15.0, 25.0
"""The usual upper bound of a round, and that of the last round with the end of the soak."""
COURSE = DATA / "prompt_course.yaml"
QUIET_S = 1.0
STILL_S = 2.0
"""How long the rover must stand at the end."""
MEMORY_MB, MEMORY_MB_PER_MIN = 4.0, 0.5
"""Growth above both is a leak: an allocator settles after a while, and a leak goes on."""
COMPARED = 5
"""Samples at the beginning and at the end whose medians are compared."""


class Usage(NamedTuple):
    """At ``t_s``: resident memory in MB (10⁶ bytes), threads, and open files, sockets among them."""

    t_s: float
    memory_mb: float
    threads: int
    files: int


def usage(pid: int) -> Usage:
    """Return the present usage of a process."""
    process = psutil.Process(pid)
    with process.oneshot():
        memory_mb = process.memory_info().rss / 1e6
        return Usage(time.monotonic(), memory_mb, process.num_threads(), process.num_fds())


def leaks(samples: Sequence[Usage], settled: int) -> Iterator[str]:
    """Name what grew in an idle process; memory counts once it has met every fault, ``settled`` samples."""
    for name in Usage._fields[1:]:
        memory = name == "memory_mb"
        judged = samples[settled:] if memory else samples
        if len(judged) > 2 * COMPARED:
            before, after = (
                median(getattr(sample, name) for sample in part)
                for part in (judged[:COMPARED], judged[-COMPARED:])
            )
            minutes = (judged[-1].t_s - judged[0].t_s) / 60.0
            # One file that is just being opened or closed is no leak; leaked ones add up.
            if after - before > (max(MEMORY_MB, MEMORY_MB_PER_MIN * minutes) if memory else 1):
                yield f"{name} grew from {before:g} to {after:g}"


def soak(
    seconds: float,
    seed: int,
    folder: Path,
    rows: Sequence[Row] = MATRIX,
    say: Callable[[str], None] = print,
) -> list[str]:
    """Inject faults for ``seconds``; return what failed. Logs and the mock's truth go to ``folder``.

    Raises RoverNcpError when the processes do not start or the rover cannot be driven at the end.
    """
    order, moments = (random_stream(seed, domain) for domain in (Domain.SOAK_ORDER, Domain.SOAK_MOMENTS))
    began_s = time.monotonic()
    rows = [row for row in rows if row.act and row.layer != "clock" and row is not SILENT_CLOSE_ROW]
    last = [row for row in rows if row.key == LAST]
    done: list[Row] = []
    failed: list[str] = []
    used: dict[str, list[Usage]] = {"bridge": [], "mock": []}
    with Rig(folder / "log", COURSE) as rig:

        def inject(row: Row, driver: str) -> None:
            at_s = time.monotonic() - began_s
            done.append(row)
            words = f"{at_s // 60:3.0f}:{at_s % 60:02.0f}  {row.layer}: {row.fault} ({driver})"
            try:
                found = _measured(rig, row, driver, len(done), moments)
                words += f": stood after {found.seconds:.2f} s of {found.bound_s + found.braking_s:.2f} s"
                right = found.in_time
            except (RoverNcpError, zenoh.ZError) as error:
                words, right = f"{words}: {error}", False
            say(words if right else f"{words}: FAILED")
            failed.extend([] if right else [words.strip()])
            _settle(rig)

        plan = _plan([row for row in rows if row.key != LAST], order)
        while time.monotonic() - began_s + ROUND_S + LAST_S * len(last) < seconds:
            inject(*next(plan))
            for name, process in (("bridge", rig.bridge), ("mock", rig.mock)):
                used[name].append(usage(process.pid))
        for row in last:
            inject(row, CIRCUIT)
        rig.end(rig.under_way(rig.scripted_driver()))
        rig.stood(time.monotonic_ns())
        stands_ns = time.monotonic_ns()
        time.sleep(STILL_S)
        if any(moving(state) for state in states_since(rig.truth, stands_ns)):
            failed.append("the rover does not stand in the end")
    for name, samples in used.items():
        if samples:
            say(f"{name}: {samples[0].memory_mb:.0f} MB at first, {samples[-1].memory_mb:.0f} MB in the end")
        failed += [f"{name} leaks: {each}" for each in leaks(samples, len(rows) - len(last))]
    say(f"{len(done)} faults; not reached: {', '.join(row.key for row in rows if row not in done) or 'none'}")
    return failed


def _plan(rows: Sequence[Row], order: np.random.Generator) -> Iterator[tuple[Row, str]]:
    """Yield rows and drivers without end: all rows once in random order, then again in another order."""
    while True:
        for place in order.permutation(len(rows)):
            drivers = rows[place].drivers
            yield rows[place], drivers[int(order.integers(len(drivers)))]


def _measured(rig: Rig, row: Row, driver: str, number: int, moments: np.random.Generator) -> Measured:
    """Measure a row. One that blocks the bridge's output for good gets a mock and a bridge of its own."""
    if not row.outlet:
        return measure(rig, row, driver, moments)
    with Rig(rig.folder / f"{number:03d}-{row.key}", rig.course, outlet=row.outlet) as own:
        return measure(own, row, driver, moments)


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


def main() -> None:
    """Soak from the command line."""
    parser = argparse.ArgumentParser(prog="python -m faults.soak")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0, help="of the order, the drivers and the moments")
    given = parser.parse_args()
    shutil.rmtree(OUT, ignore_errors=True)
    failed = soak(given.minutes * 60.0, given.seed, OUT, say=partial(print, flush=True))
    print("\n".join(f"failed: {each}" for each in failed) or "all checks passed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
