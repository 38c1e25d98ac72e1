"""Memory, threads, files and sockets of a process, and whether they grow (Linux's /proc)."""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

MEMORY_MB, MEMORY_MB_PER_MIN = 4.0, 0.5
"""Growth above both is a leak: an allocator settles after a while, and a leak goes on."""
MEMORY_SAMPLES = 10
"""With fewer samples memory is not judged."""
SHARE = 0.2
"""The part of all samples, at the beginning and at the end, whose medians are compared."""


class Usage(NamedTuple):
    """At ``t_s``: resident memory in MB (10⁶ bytes), threads, open files, how many of those are sockets."""

    t_s: float
    memory_mb: float
    threads: int
    files: int
    sockets: int


class Leaks(NamedTuple):
    """First and last values; ``leaking`` names what grew."""

    memory_mb: tuple[float, float]
    threads: tuple[int, int]
    files: tuple[int, int]
    sockets: tuple[int, int]
    leaking: tuple[str, ...]


def usage(pid: int, t_s: float) -> Usage:
    """Return the present usage of a process. Raises OSError when it does not exist."""
    process = Path("/proc") / str(pid)
    lines = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
    links = []
    for link in (process / "fd").iterdir():
        try:
            links.append(str(link.readlink()))
        except FileNotFoundError:  # closed meanwhile
            continue
    sockets = sum(link.startswith("socket:") for link in links)
    memory_mb = int(lines["VmRSS"].split()[0]) * 1024 / 1e6
    return Usage(t_s, memory_mb, int(lines["Threads"]), len(links), sockets)


def leaks(samples: Sequence[Usage], settled: int) -> Leaks:
    """Compare the last samples of one process, taken while it was idle, with its first.

    Memory counts from sample ``settled`` on, when the process has met every fault once.
    """
    later = samples[settled:]
    judged = len(later) >= MEMORY_SAMPLES
    memory = _medians(later if judged else samples, "memory_mb")
    minutes = (later[-1].t_s - later[0].t_s) / 60.0 if judged else 0.0
    growing = []
    if judged and memory[1] - memory[0] > max(MEMORY_MB, MEMORY_MB_PER_MIN * minutes):
        growing.append("memory")
    whole = {}
    for name in ("threads", "files", "sockets"):
        before, after = _medians(samples, name)
        whole[name] = (round(before), round(after))
        # One that is just being opened or closed is no leak; leaked ones add up.
        if after > before + 1:
            growing.append(name)
    return Leaks(memory, whole["threads"], whole["files"], whole["sockets"], tuple(growing))


def _medians(samples: Sequence[Usage], name: str) -> tuple[float, float]:
    count = max(round(len(samples) * SHARE), 1)
    first, last = ([getattr(sample, name) for sample in part] for part in (samples[:count], samples[-count:]))
    return statistics.median(first), statistics.median(last)
