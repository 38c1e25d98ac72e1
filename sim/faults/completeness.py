"""Check that a recording holds all messages its driver could receive, except losses that a fault explains."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from rover_ncp.core.key_table import spec
from rover_ncp.core.recording import Recording, header_stamp_ns, read_recording, rewrite

SIP_NS = 100_000_000
LOST_NS = 500_000_000
"""The time at the end of its recording that a killed process may lose."""


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
    path: Path, heard_ns: Sequence[int], began_ns: int, *, killed: bool, losing: bool
) -> Completeness:
    """Compare a recording with the stamps ``heard_ns`` of all odometry that another subscriber received.

    The recording must hold all of them up to ``began_ns``, when the fault began. It must hold the later ones
    too, unless the fault is ``losing`` messages. A ``killed`` process may lose its last half second. A
    recording that was cut off is repaired first. Raises FileError.
    """
    recording = read_recording(path)
    recovered = not recording.complete
    if recovered:
        rewrite(recording, path)
        recording = read_recording(path)
    stamps = _stamps(recording)
    if not stamps:
        return Completeness(path, recovered, 0, 1, 0, 0)
    until_ns = began_ns - LOST_NS if killed else began_ns if losing else max(stamps[-1], began_ns)
    held = set(stamps)
    missing = sum(stamps[0] <= stamp <= until_ns and stamp not in held for stamp in heard_ns)
    sequences = [message.sequence for message in recording.topic("cmd_vel")]
    skipped = sum(after != before + 1 for before, after in pairwise(sequences))
    return Completeness(
        path, recovered, len(stamps), missing, _gaps(stamps, min(until_ns, began_ns)), skipped
    )


def _stamps(recording: Recording) -> list[int]:
    odometry = spec("odom").type
    found = (header_stamp_ns(odometry, message.data) for message in recording.topic("odom"))
    return [stamp for stamp in found if stamp is not None]


def _gaps(stamps: Sequence[int], until_ns: int) -> int:
    """Return how many SIPs have no odometry message before ``until_ns``; a SIP is due every 0.1 s.

    Stamps are those of arrival. The first or last of them may be late by a part of that period.
    """
    before = [stamp for stamp in stamps if stamp <= until_ns]
    if not before:
        return 0
    expected = round((before[-1] - before[0]) / SIP_NS) + 1
    missing = expected - len(before)
    return missing if missing > 1 else 0
