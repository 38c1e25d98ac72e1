"""The phases of a manoeuvre: driving straight, turning or standing, by the rover's commands.

A tick is labelled by the signs of its command, where a command below a tenth of the circuit's reach is none;
phases shorter than half a second belong to their longer neighbour.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.report.trace import Trace, motor_shares
from rover_ncp.core.geometry import wrap_angle

FloatArray = NDArray[np.float64]

IDLE = 0.1
SHORTEST_S = 0.5
LABELS = {
    (0, 0): "standing still",
    (1, 0): "straight ahead",
    (1, 1): "left turn",
    (1, -1): "right turn",
    (0, 1): "left turn on the spot",
    (0, -1): "right turn on the spot",
    (-1, 0): "straight back",
    (-1, 1): "left turn backwards",
    (-1, -1): "right turn backwards",
}
"""By the signs of v and omega."""


@dataclass(frozen=True)
class Phase:
    """One phase: ticks ``first`` up to, not including, ``last``."""

    label: str
    signs: tuple[int, int]
    first: int
    last: int
    start_s: float
    end_s: float
    driven_m: float
    """Length of the way."""
    turned_rad: float
    """Change of heading, left positive."""

    @property
    def ticks(self) -> slice:
        """The phase's part of the run."""
        return slice(self.first, self.last)


def phases(trace: Trace) -> tuple[Phase, ...]:
    """Return a run's phases, in order and without gaps. The policy's outputs must be v and omega."""
    if not len(trace.times):
        return ()
    signs = _signs(trace)
    runs = _joined([_Run((v, omega), 1) for v, omega in signs.tolist()])
    shortest = max(1, round(SHORTEST_S / trace.policy.tick_s))
    while len(runs) > 1 and min(run.ticks for run in runs) < shortest:
        runs = _merged(runs)
    found, first = [], 0
    for run in runs:
        found.append(_phase(trace, run.signs, first, first + run.ticks))
        first += run.ticks
    return tuple(found)


class _Run(NamedTuple):
    signs: tuple[int, int]
    ticks: int


def _signs(trace: Trace) -> NDArray[np.int64]:
    """Return the signs (T, 2) of the commands, 0 where a command is none."""
    nothing = np.full((1, trace.potentials.shape[1]), trace.policy.motors.low_mV)
    all_out = np.full((1, trace.potentials.shape[1]), trace.policy.motors.high_mV)
    reach = np.zeros(2)
    for (_, full), (_, none) in zip(
        motor_shares(trace.policy, all_out), motor_shares(trace.policy, nothing), strict=True
    ):
        reach = np.maximum(reach, np.abs(full - none)[0])
    signs: NDArray[np.int64] = np.sign(trace.commands).astype(np.int64)
    signs[np.abs(trace.commands) < IDLE * reach] = 0
    return signs


def _merged(runs: Sequence[_Run]) -> list[_Run]:
    """Give the shortest run to its longer neighbour."""
    shortest = min(range(len(runs)), key=lambda i: runs[i].ticks)
    neighbours = [i for i in (shortest - 1, shortest + 1) if 0 <= i < len(runs)]
    longer = max(neighbours, key=lambda i: runs[i].ticks)
    given = [_Run(runs[longer].signs, run.ticks) if i == shortest else run for i, run in enumerate(runs)]
    return _joined(given)


def _joined(runs: Sequence[_Run]) -> list[_Run]:
    """Make one of neighbours with the same signs."""
    return [
        _Run(signs, sum(run.ticks for run in group))
        for signs, group in groupby(runs, key=lambda run: run.signs)
    ]


def _phase(trace: Trace, signs: tuple[int, int], first: int, last: int) -> Phase:
    way = trace.poses[first : last + 1]
    end_s = trace.times[last] if last < len(trace.times) else trace.times[-1] + trace.policy.tick_s
    return Phase(
        label=LABELS[signs],
        signs=signs,
        first=first,
        last=last,
        start_s=float(trace.times[first]),
        end_s=float(end_s),
        driven_m=float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum()),
        turned_rad=sum(wrap_angle(b - a) for a, b in zip(way[:-1, 2], way[1:, 2], strict=True)),
    )
