"""Report of a soak: what failed, and a table for the documentation."""

from collections.abc import Iterator

from faults.losses import Leaks, leaks
from faults.soak import Round, Soaked
from faults.table import MATRIX


def line(done: Round) -> str:
    """Return a round in one line for people."""
    where = (
        f"{done.at_s // 60:3.0f}:{done.at_s % 60:02.0f}  {done.row.layer}: {done.row.fault} ({done.driver})"
    )
    found = done.measured
    if found is None:
        return f"{where}: FAILED: {done.failure}"
    late = "" if found.in_time else "TOO LATE, "
    allowed = found.bound_s + found.braking_s
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
            yield f"{head} {worst.seconds:.2f} s | {worst.bound_s:g} s + {worst.braking_s:.2f} s braking |"
        elif times:
            yield f"{head} failed | |"
