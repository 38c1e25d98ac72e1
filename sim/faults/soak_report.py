"""Report of a soak: JSON fields for programs, a table for the documentation."""

from collections.abc import Iterator
from typing import Any

from sim.faults.losses import Leaks, leaks
from sim.faults.soak import Round, Soaked
from sim.faults.table import MATRIX


def line(done: Round) -> str:
    """Return a round in one line for people."""
    where = (
        f"{done.at_s // 60:3.0f}:{done.at_s % 60:02.0f}  {done.row.layer}: {done.row.fault} ({done.driver})"
    )
    found = done.measured
    if found is None:
        return f"{where}: FAILED: {done.failure}"
    late = "" if found.in_time else "TOO LATE, "
    allowed = found.row.bound_s + found.braking_s
    return f"{where}: {late}stood after {found.seconds:.2f} s of {allowed:.2f} s"


def verdict(soaked: Soaked) -> list[str]:
    """Return every failed check in words; empty when all passed."""
    wrong = [line(done).strip() for done in soaked.rounds if not done.passed]
    for name, found in _leaks(soaked).items():
        values = found._asdict() | {"memory": found.memory_mb}
        wrong += [f"{name} leaks {what}: {values[what]}" for what in found.leaking]
    wrong += [
        f"{each.path.name}: lost {each.missing} odometry messages, {each.gaps} SIPs, {each.skipped} commands"
        for each in soaked.recordings
        if each.lost
    ]
    if not soaked.still:
        wrong.append("the rover does not stand in the end")
    return wrong


def _leaks(soaked: Soaked) -> dict[str, Leaks]:
    return {name: leaks(samples, soaked.settled) for name, samples in soaked.usage.items() if samples}


def fields(soaked: Soaked, seed: int) -> dict[str, Any]:
    """Return the command's JSON."""
    wrong = verdict(soaked)
    recordings = soaked.recordings
    return {
        "passed": not wrong,  #: whether nothing is wrong
        "wrong": wrong,  #: the problems, in words
        "seed": seed,
        "wall_s": soaked.wall_s,
        "load": soaked.load,  #: highest load average of a minute
        "rounds": [_round_fields(done) for done in soaked.rounds],  #: one fault each
        "not_reached": [row.key for row in soaked.not_reached],  #: rows
        "still": soaked.still,  #: whether the rover stands in the end
        #: bridge and mock: each first and last
        "processes": {name: found._asdict() for name, found in _leaks(soaked).items()},
        "recordings": {  #: of all; unexplained are missing messages, gaps of SIPs and skipped commands
            "count": len(recordings),
            **{
                name: sum(getattr(each, name) for each in recordings)
                for name in ("recovered", "odometry", "missing", "gaps", "skipped")
            },
        },
    }


def _round_fields(done: Round) -> dict[str, Any]:
    found = done.measured
    return {
        "row": done.row.key,  #: of the safety matrix
        "at_s": done.at_s,  #: since the beginning
        "driver": done.driver,  #: hand, that is the scripted driver, or circuit
        "passed": done.passed,  #: whether it stood in time
        "failure": done.failure,  #: why it was not measured, or empty
        "stands_after_s": found.seconds if found else None,  #: until the rover stood
        #: the longest that the machine kept mock and line from running
        "late_s": found.late_s if found else None,
        "bound_s": done.row.bound_s,  #: allowed, without braking
        "braking_s": found.braking_s if found else None,  #: from the speed that it had
        "stopped_by": found.stopped_by if found else "",  #: the safety rule
        "note": found.note if found else "",  #: what the driver said
    }


def table(soaked: Soaked) -> Iterator[str]:
    """Yield the rows as Markdown: how often each occurred, and the time with the least margin."""
    yield "| layer | fault | times | slowest stands after | allowed |"
    yield "|---|---|---:|---:|---|"
    for row in MATRIX:
        found = [done.measured for done in soaked.rounds if done.row == row and done.measured is not None]
        times = sum(done.row == row for done in soaked.rounds)
        head = f"| {row.layer} | {row.fault} | {times} |"
        if found:
            worst = max(found, key=lambda each: each.seconds - each.braking_s)
            yield f"{head} {worst.seconds:.2f} s | {row.allowed} + {worst.braking_s:.2f} s braking |"
        elif times:
            yield f"{head} failed | {row.allowed} |"
