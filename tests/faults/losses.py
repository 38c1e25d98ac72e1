"""Leaks of a long-running process, and losses of a recording."""

import statistics
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import psutil

from rover_ncp.recording.recording import header_stamp_ns, read_recording, rewrite
from rover_ncp.wire.key_table import spec

MEMORY_MB, MEMORY_MB_PER_MIN = 4.0, 0.5
"""Growth above both is a leak: an allocator settles after a while, and a leak goes on."""
MEMORY_SAMPLES = 10
"""With fewer samples memory is not judged."""
SHARE = 0.2
"""The part of all samples, at the beginning and at the end, whose medians are compared."""
SIP_NS = 100_000_000
LOST_NS = 500_000_000
"""The time at the end of its recording that a killed process may lose."""


class Usage(NamedTuple):
    """At ``t_s``: resident memory in MB (10⁶ bytes), threads, and open files, sockets among them."""

    t_s: float
    memory_mb: float
    threads: int
    files: int


def usage(pid: int, t_s: float) -> Usage:
    """Return the present usage of a process. Raises psutil.NoSuchProcess."""
    process = psutil.Process(pid)
    with process.oneshot():
        return Usage(t_s, process.memory_info().rss / 1e6, process.num_threads(), process.num_fds())


def leaks(samples: Sequence[Usage], settled: int) -> list[str]:
    """Name what grew between the first samples of one process, taken while it was idle, and its last.

    Memory counts from sample ``settled`` on, when the process has met every fault once.
    """
    found = []
    for name in Usage._fields[1:]:
        memory = name == "memory_mb"
        judged = samples[settled:] if memory else samples
        if len(judged) < (MEMORY_SAMPLES if memory else 1):
            continue
        values, count = [getattr(sample, name) for sample in judged], max(round(len(judged) * SHARE), 1)
        before, after = statistics.median(values[:count]), statistics.median(values[-count:])
        minutes = (judged[-1].t_s - judged[0].t_s) / 60.0
        # One file that is just being opened or closed is no leak; leaked ones add up.
        if after - before > (max(MEMORY_MB, MEMORY_MB_PER_MIN * minutes) if memory else 1):
            found.append(f"{name} grew from {before:g} to {after:g}")
    return found


class Completeness(NamedTuple):
    """How much of a drive a recording holds."""

    path: Path
    recovered: bool
    odometry: int
    missing: int
    """Odometry messages that another subscriber received and the recording lacks."""
    gaps: int
    """SIPs without an odometry message."""
    skipped: int
    """Missing commands between recorded ones."""

    @property
    def lost(self) -> int:
        """The number of messages lost without an explanation."""
        return self.missing + self.gaps + self.skipped


def check_recording(
    path: Path, received_ns: Sequence[int], began_ns: int, *, killed: bool, losing: bool
) -> Completeness:
    """Compare a recording with the stamps ``received_ns`` of all odometry that another subscriber received.

    The recording must hold all of them up to ``began_ns``, when the fault began. It must hold the later ones
    too, unless the fault is ``losing`` messages. A ``killed`` process may lose its last half second. A
    recording that was cut off is repaired first. Raises FileError.
    """
    recording = read_recording(path)
    recovered = not recording.complete
    if recovered:
        rewrite(recording, path)
        recording = read_recording(path)
    found = (header_stamp_ns(spec("odom").type, message.data) for message in recording.topic("odom"))
    stamps = [stamp for stamp in found if stamp is not None]
    if not stamps:
        return Completeness(path, recovered, 0, 1, 0, 0)
    until_ns = began_ns - LOST_NS if killed else began_ns if losing else max(stamps[-1], began_ns)
    held = set(stamps)
    missing = sum(stamps[0] <= stamp <= until_ns and stamp not in held for stamp in received_ns)
    sequences = [message.sequence for message in recording.topic("cmd_vel")]
    skipped = sum(after != before + 1 for before, after in pairwise(sequences))
    before = [stamp for stamp in stamps if stamp <= min(until_ns, began_ns)] or stamps[:1]
    gaps = round((before[-1] - before[0]) / SIP_NS) + 1 - len(before)
    # Stamps are those of arrival: the first or last of them may be late by a part of a SIP's period.
    return Completeness(path, recovered, len(stamps), missing, gaps if gaps > 1 else 0, skipped)
