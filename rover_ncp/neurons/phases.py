"""Phases of a manoeuvre (driving straight, turning, standing) and the neurons that caused them, in numbers.

Ticks are grouped by the signs of their commands; below a tenth of the circuit's range a command is zero.
Phases shorter than half a second are merged with their longer neighbour. A phase is named for its net motion,
less of which counts if its commands ask for it. A phase is explained backwards from its output: the
motor neuron with the largest share in it, the neuron whose synapse pulls most on that motor neuron, and the
synapses that pull most on that neuron. Pulls are means over the phase in mV (`rover_ncp.neurons.trace`).
"""

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rover_ncp.circuit.circuit import MIDPOINT_MV
from rover_ncp.core.config import ResultModel
from rover_ncp.core.geometry import Velocity, wrap_angle
from rover_ncp.neurons.trace import Currents, FloatArray, Trace, motor_shares, synapse_currents

V, OMEGA = 0, 1
IDLE = 0.1
MIN_PHASE_S = 0.5
VISIBLE = (0.05, float(np.radians(10.0)))
"""Way in m and turn in rad that name a phase whose commands count as zero."""
ASKED = (0.01, float(np.radians(2.5)))
"""Way and turn that name a phase whose commands ask for them."""
STILL = (0.005, float(np.radians(0.5)))
"""Way and turn from which on a phase is not called standing still; smaller ones are not shown."""
LABELS: dict[tuple[int, ...], str] = {
    (0, 0): "hardly moving",
    (1, 0): "straight ahead",
    (1, 1): "left turn",
    (1, -1): "right turn",
    (0, 1): "left turn on the spot",
    (0, -1): "right turn on the spot",
    (-1, 0): "straight back",
    (-1, 1): "left turn backwards",
    (-1, -1): "right turn backwards",
}
"""By the signs of v and omega in the rover's frame."""

WEAK_MV = 1.0
"""If all pulls on a motor neuron are weaker in a phase, the strongest in the whole run counts."""
CHANGE_MV = 3.0
"""Least change of a pull between phases that counts."""
LEAK_MV = 5.0
"""If no synapse pulls a motor neuron by more, its leak determines its potential."""


class Phase(ResultModel):
    """One phase: ticks ``first`` up to, not including, ``last``."""

    label: str = Field(description="what the rover does")
    signs: tuple[int, ...] = Field(exclude=True, description="of each output, as the policy means it")
    first: int = Field(exclude=True)
    last: int = Field(exclude=True)
    start_s: float = Field(description="time at its beginning")
    end_s: float = Field(description="time at its end")
    driven_m: float = Field(description="length of the path")
    turned_rad: float = Field(description="change of heading, left positive")

    @property
    def ticks(self) -> slice:
        """The phase's part of the run."""
        return slice(self.first, self.last)


class Mean(ResultModel):
    """A neuron with a mean over a phase."""

    neuron: str = Field(description="its name")
    mean_mV: float = Field(description="mean of its potential or its pull")


class Change(ResultModel):
    """A pull in two phases."""

    neuron: str = Field(description="its name")
    before_mV: float = Field(description="the pull in the phase before")
    now_mV: float = Field(description="the pull in this phase")


class ExplainedPhase(Phase):
    """Explanation of the rover's motion in one phase."""

    motor: Mean = Field(description="motor neuron with the largest share in the output, and its potential")
    behind: Mean | None = Field(
        default=None, description="neuron that pulls most on the motor neuron, or null"
    )
    by_leak: bool = Field(default=True, description="whether the leak alone determines the potential")
    opening: float | None = Field(
        default=None, description="of the synapse of `behind`, 0 to 1; null for a gap junction"
    )
    pulls: tuple[Mean, ...] = Field(default=(), description="on the neuron behind, the strongest first")
    change: Change | None = Field(default=None, description="that changed most since the phase before")
    sentence: str = Field(default="", description="all this in words")


def phases(trace: Trace) -> tuple[Phase, ...]:
    """Return a run's phases, in order and without gaps."""
    runs = [_Run(tuple(signs), 1) for signs in _signs(trace).tolist()]
    shortest = max(1, round(MIN_PHASE_S / trace.policy.tick_s))
    runs = _joined(runs)
    while len(runs) > 1 and min(run.ticks for run in runs) < shortest:
        short = min(range(len(runs)), key=lambda i: runs[i].ticks)
        longer = max((i for i in (short - 1, short + 1) if 0 <= i < len(runs)), key=lambda i: runs[i].ticks)
        runs[short] = _Run(runs[longer].signs, runs[short].ticks)
        runs = _joined(runs)
    runs = _joined([_named(trace, *each) for each in _placed(runs)])
    return tuple(_phase(trace, run, first, last) for run, first, last in _placed(runs))


def explain(trace: Trace) -> tuple[ExplainedPhase, ...]:
    """Explain a run phase by phase."""
    currents = synapse_currents(trace.policy.circuit, trace.potentials)
    found = phases(trace)
    return tuple(_explained(trace, currents, *both) for both in zip(found, (None, *found), strict=False))


class _Run(NamedTuple):
    signs: tuple[int, ...]
    ticks: int
    moves: tuple[int, ...] = ()
    """Signs of the motion in the rover's frame; empty before it is known."""


def _placed(runs: Sequence[_Run]) -> list[tuple[_Run, int, int]]:
    """Return each run with its first tick and the one after its last."""
    ends = np.cumsum([0, *(run.ticks for run in runs)]).tolist()
    return list(zip(runs, ends[:-1], ends[1:], strict=True))


def _named(trace: Trace, run: _Run, first: int, last: int) -> _Run:
    """Return a run with the signs of its visible motion, in the policy's frame and in the rover's.

    A policy that backs the rover out of a place has its poses turned by 180°: its positive v is a way back.
    """
    moved = _motion(trace.poses[first : last + 1])
    visible = np.abs(moved) >= np.where(run.signs, ASKED, VISIBLE)
    moves = np.where(visible, np.sign(moved), 0).astype(int).tolist()
    asked = int(np.sign(trace.commands[first:last, V].sum()))
    return run._replace(signs=(asked or moves[V] if moves[V] else 0, moves[OMEGA]), moves=tuple(moves))


def _motion(poses: FloatArray) -> tuple[float, float]:
    """Return the way in m along the rover's own axis, forward positive, and its turn in rad."""
    step, heading = np.diff(poses[:, :2], axis=0), poses[:-1, 2]
    ahead = step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading)
    turned = sum(wrap_angle(b - a) for a, b in zip(heading, poses[1:, 2], strict=True))
    return float(ahead.sum()), turned


def _signs(trace: Trace) -> NDArray[np.int64]:
    """Return the signs (T, outputs) of the commands, 0 for a command that counts as zero."""
    motors, size = trace.policy.motors, trace.potentials.shape[1]
    limits = np.array([np.full(size, motors.low_mV), np.full(size, motors.high_mV)])
    spans = [np.abs(np.diff(share, axis=0))[0] for _, share in motor_shares(trace.policy, limits)]
    signs: NDArray[np.int64] = np.sign(trace.commands).astype(np.int64)
    signs[np.abs(trace.commands) < IDLE * np.max(spans, axis=0)] = 0
    return signs


def _joined(runs: Sequence[_Run]) -> list[_Run]:
    """Join neighbours with the same signs."""
    groups = groupby(runs, key=lambda run: (run.signs, run.moves))
    return [_Run(signs, sum(run.ticks for run in group), moves) for (signs, moves), group in groups]


def _phase(trace: Trace, run: _Run, first: int, last: int) -> Phase:
    way = trace.poses[first : last + 1]
    driven_m = float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum())
    _, turned_rad = _motion(way)
    still = run.moves == (0, 0) and driven_m < STILL[0] and abs(turned_rad) < STILL[1]
    end_s = trace.times[last] if last < len(trace.times) else trace.times[-1] + trace.policy.tick_s
    return Phase(
        label="standing still" if still else LABELS[run.moves],
        signs=run.signs,
        first=first,
        last=last,
        start_s=float(trace.times[first]),
        end_s=float(end_s),
        driven_m=driven_m,
        turned_rad=turned_rad,
    )


def _explained(trace: Trace, currents: Currents, phase: Phase, before: Phase | None) -> ExplainedPhase:
    def mean(neuron: str) -> Mean:
        return Mean(neuron=neuron, mean_mV=float(trace.of(neuron)[phase.ticks].mean()))

    circuit = trace.policy.circuit
    motor = _motor(trace, phase)
    found = ExplainedPhase(**dict(phase), motor=mean(motor))
    synapse = _strongest(trace, currents, motor, phase)
    if synapse is None:
        return found
    behind = circuit.neurons[circuit.source[synapse]]
    above = trace.of(behind)[phase.ticks] - MIDPOINT_MV
    opening = float((1.0 / (1.0 + np.exp(-circuit.sigma[synapse] * above))).mean())
    pulls = _pulls(trace, currents, behind, phase)
    more = {
        "behind": mean(behind),
        "by_leak": bool(abs(currents.pull[phase.ticks, synapse].mean()) < LEAK_MV),
        "opening": opening if circuit.chemical[synapse] else None,
        "pulls": pulls,
        "change": _change(_pulls(trace, currents, behind, before), pulls) if before else None,
    }
    return found.model_copy(update=more)


def _motor(trace: Trace, phase: Phase) -> str:
    """Return the motor neuron with the largest share in a phase's output."""
    shares = motor_shares(trace.policy, trace.potentials)
    # A turn explains more than the speed; the first output that acts, where they are others.
    acting = [i for i, sign in enumerate(phase.signs) if sign]
    output = OMEGA if trace.outputs == Velocity._fields and OMEGA in acting else (acting or [V])[0]
    if not any(phase.signs):  # standing still: the neuron that could have moved it
        reach = [float(np.abs(share[:, V]).max()) for _, share in shares]
        return shares[int(np.argmax(reach))][0]
    sign = phase.signs[output]
    share_of = [sign * float(share[phase.ticks, output].mean()) for _, share in shares]
    return shares[int(np.argmax(share_of))][0]


def _strongest(trace: Trace, currents: Currents, neuron: str, phase: Phase) -> int | None:
    """Return the synapse that pulls most on a neuron in a phase; if all are weak there, in the whole run."""
    circuit = trace.policy.circuit
    synapses = np.flatnonzero(circuit.destination == circuit.index(neuron))
    if not len(synapses):
        return None
    pull = np.abs(currents.pull[phase.ticks, synapses]).mean(axis=0)
    if pull.max() < WEAK_MV:
        pull = np.abs(currents.pull[:, synapses]).max(axis=0)
    return int(synapses[np.argmax(pull)])


def _pulls(trace: Trace, currents: Currents, neuron: str, phase: Phase) -> tuple[Mean, ...]:
    circuit = trace.policy.circuit
    if neuron in trace.policy.sensing.neurons:
        return ()
    synapses = np.flatnonzero(circuit.destination == circuit.index(neuron))
    means = currents.pull[phase.ticks, synapses].mean(axis=0)
    rows = [
        Mean(neuron=circuit.neurons[circuit.source[s]], mean_mV=float(m))
        for s, m in zip(synapses, means, strict=True)
    ]
    return tuple(sorted(rows, key=lambda row: -abs(row.mean_mV)))


def _change(before: Sequence[Mean], now: Sequence[Mean]) -> Change | None:
    then = {pull.neuron: pull.mean_mV for pull in before}
    changes = [Change(neuron=pull.neuron, before_mV=then[pull.neuron], now_mV=pull.mean_mV) for pull in now]
    most = max(changes, key=lambda change: abs(change.now_mV - change.before_mV), default=None)
    return most if most and abs(most.now_mV - most.before_mV) >= CHANGE_MV else None
