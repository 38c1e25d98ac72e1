"""A sentence for each phase of a manoeuvre: the neurons that caused it, and those that drove them.

All from the run's numbers. A phase is explained backwards from its output: the motor neuron that gives most
of it, the neuron whose synapse pulls most on that one, and the synapses that pull most on that in turn.
Pulls are means over the phase, in mV (`deploy.report.currents`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.report.currents import Currents, synapse_currents
from deploy.report.layout import labels
from deploy.report.phases import Phase, phases
from deploy.report.trace import Trace, motor_shares
from rover_ncp.circuit.circuit import MIDPOINT_MV, Circuit
from rover_ncp.circuit.policy import Policy

FloatArray = NDArray[np.float64]

V, OMEGA = 0, 1
LEAST_MV = 1.0
"""A weaker pull is left out,"""
LEAST_SHARE = 0.15
"""and so is one that is small beside the strongest."""
MOST = 2
"""Neurons named on either side."""
LEAST_CHANGE_MV = 3.0
SWING_MV = 5.0
"""Sensory neurons change by less in a tick of any drive, so a wider swing is the circuit's own."""
LEAK_MV = 5.0
"""A motor neuron that no synapse pulls farther is where its own leak puts it."""


class Level(NamedTuple):
    """A neuron and its potential."""

    neuron: str
    mean_mV: float


class Pull(NamedTuple):
    """A neuron that pulls on another, and how far in mV."""

    neuron: str
    mean_mV: float


class Change(NamedTuple):
    """The pull that changed most since the phase before."""

    neuron: str
    before_mV: float
    now_mV: float


@dataclass(frozen=True)
class Explanation:
    """Explanation of the rover's motion in one phase; values in mV are means over the phase."""

    phase: Phase
    motor: Level
    """The motor neuron that gives most of the phase's output."""
    rival: Level | None
    """The motor neuron that works most against it, if any does."""
    behind: Level | None
    """The neuron that pulls most on the motor neuron; None if nothing feeds it."""
    by_leak: bool
    """Whether the motor neuron is where its leak puts it, and no synapse has much to do with it."""
    activity: str
    """How open that neuron's synapse is: active (over a half), partly active, quiet (under a tenth)."""
    pulls: tuple[Pull, ...]
    """On the neuron behind, the strongest first."""
    change: Change | None
    swinging: tuple[Level, ...]
    """Neurons that alternate, with their mean absolute change from tick to tick in mV, the widest first."""
    text: str = ""
    """The sentence, or two."""


def explain(trace: Trace) -> tuple[Explanation, ...]:
    """Explain a run phase by phase. The policy's outputs must be v and omega."""
    currents = synapse_currents(trace.policy.circuit, trace.potentials)
    found: list[Explanation] = []
    for phase in phases(trace):
        before = found[-1].phase if found else None
        found.append(_explained(trace, currents, phase, before))
    return tuple(found)


def _explained(trace: Trace, currents: Currents, phase: Phase, before: Phase | None) -> Explanation:
    circuit = trace.policy.circuit
    motor, rival = _motors(trace, phase)
    synapse = _strongest(circuit, currents, motor, phase)
    behind = None if synapse is None else circuit.neurons[circuit.source[synapse]]

    def level(neuron: str) -> Level:
        return Level(neuron, float(trace.of(neuron)[phase.ticks].mean()))

    found = Explanation(
        phase=phase,
        motor=level(motor),
        rival=None if rival is None else level(rival),
        behind=None if behind is None else level(behind),
        by_leak=synapse is None or abs(currents.pull[phase.ticks, synapse].mean()) < LEAK_MV,
        activity="" if synapse is None else _activity(trace, phase, synapse),
        pulls=() if behind is None else _pulls(circuit, currents, behind, phase),
        change=None if behind is None else _change(circuit, currents, behind, before, phase),
        swinging=_swinging(trace, phase),
    )
    return replace(found, text=_Words(trace.policy).text(found))


def _motors(trace: Trace, phase: Phase) -> tuple[str, str | None]:
    """Return the motor neuron behind a phase's output, and the one that works against it."""
    shares = motor_shares(trace.policy, trace.potentials)
    output = OMEGA if phase.signs[OMEGA] else V
    sign = phase.signs[output] or 1
    for_it = [sign * float(share[phase.ticks, output].mean()) for _, share in shares]
    if not any(phase.signs):  # standing still: the neuron that could have moved it
        reach = [float(np.abs(share[:, V]).max()) for _, share in shares]
        return shares[int(np.argmax(reach))][0], None
    best, worst = int(np.argmax(for_it)), int(np.argmin(for_it))
    rival = shares[worst][0] if for_it[worst] < -LEAST_SHARE * for_it[best] else None
    return shares[best][0], rival


def _strongest(circuit: Circuit, currents: Currents, neuron: str, phase: Phase) -> int | None:
    """Return the synapse that pulls most on a neuron in a phase; if none does, the most over the run."""
    synapses = np.flatnonzero(circuit.destination == circuit.index(neuron))
    if not len(synapses):
        return None
    pull = np.abs(currents.pull[phase.ticks, synapses]).mean(axis=0)
    if pull.max() < LEAST_MV:
        pull = np.abs(currents.pull[:, synapses]).max(axis=0)
    return int(synapses[np.argmax(pull)])


def _activity(trace: Trace, phase: Phase, synapse: int) -> str:
    circuit = trace.policy.circuit
    potential = trace.potentials[phase.ticks, circuit.source[synapse]]
    gate = float(np.mean(1.0 / (1.0 + np.exp(-circuit.sigma[synapse] * (potential - MIDPOINT_MV)))))
    return "active" if gate > 0.5 else "partly active" if gate > 0.1 else "quiet"


def _pulls(circuit: Circuit, currents: Currents, neuron: str, phase: Phase) -> tuple[Pull, ...]:
    synapses = np.flatnonzero(circuit.destination == circuit.index(neuron))
    rows = [
        Pull(circuit.neurons[circuit.source[s]], float(currents.pull[phase.ticks, s].mean()))
        for s in synapses
    ]
    return tuple(sorted(rows, key=lambda row: -abs(row.mean_mV)))


def _change(
    circuit: Circuit, currents: Currents, neuron: str, before: Phase | None, phase: Phase
) -> Change | None:
    if before is None:
        return None
    then = {pull.neuron: pull.mean_mV for pull in _pulls(circuit, currents, neuron, before)}
    changes = [
        Change(pull.neuron, then[pull.neuron], pull.mean_mV)
        for pull in _pulls(circuit, currents, neuron, phase)
    ]
    most = max(changes, key=lambda change: abs(change.now_mV - change.before_mV), default=None)
    if most is None or abs(most.now_mV - most.before_mV) < LEAST_CHANGE_MV:
        return None
    return most


def _swinging(trace: Trace, phase: Phase) -> tuple[Level, ...]:
    steps = np.diff(trace.potentials[phase.ticks], axis=0)
    if len(steps) < 2:
        return ()
    # One jump at the start of a phase is no swing: it must go back and forth.
    turning = np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) * (steps[1:] * steps[:-1] < 0)
    widths = turning.mean(axis=0)
    rows = [Level(name, float(width)) for name, width in zip(trace.neurons, widths, strict=True)]
    return tuple(sorted((row for row in rows if row.mean_mV > SWING_MV), key=lambda row: -row.mean_mV))


class _Words:
    """Puts an explanation's numbers into words."""

    def __init__(self, policy: Policy) -> None:
        meanings = labels(policy)
        self._senses = {neuron: meanings[neuron] for neuron in policy.sensing.neurons}

    def text(self, explained: Explanation) -> str:
        """Return the sentence, or two."""
        parts = [f"{self._head(explained.phase)}: "]
        motor = f"{explained.motor.neuron} at {_mv(explained.motor.mean_mV)}"
        if explained.by_leak:
            parts.append(f"{motor} by its own leak")
        if explained.behind is not None:
            parts.append(", " if explained.by_leak else "")
            parts.append(
                f"{self._name(explained.behind.neuron)} {explained.activity} "
                f"({_mv(explained.behind.mean_mV)})"
            )
            parts.append(self._reasons(explained.pulls))
        if not explained.by_leak:
            parts.append(f"; it puts {motor}")
        if explained.rival is not None:
            parts.append(f"; against it {explained.rival.neuron} at {_mv(explained.rival.mean_mV)}")
        parts.append(".")
        if explained.behind is not None and (change := explained.change) is not None:
            verb = "grew" if abs(change.now_mV) > abs(change.before_mV) else "fell"
            parts.append(
                f" What changed: the pull of {self._name(change.neuron)} on {explained.behind.neuron} {verb} "
                f"from {_mv(change.before_mV, sign=True)} to {_mv(change.now_mV, sign=True)}."
            )
        if explained.swinging:
            swings = " and ".join(
                f"{row.neuron} (by {_mv(row.mean_mV)})" for row in explained.swinging[:MOST]
            )
            parts.append(
                f" From tick to tick {swings} {'swings' if len(explained.swinging) == 1 else 'swing'}."
            )
        return "".join(parts)

    def _head(self, phase: Phase) -> str:
        label = phase.label[0].upper() + phase.label[1:]
        moved = [f"{phase.driven_m:.2f} m"] if phase.driven_m >= 0.005 else []
        if abs(degrees := float(np.degrees(phase.turned_rad))) >= 0.5:
            moved.append(f"{_number(degrees, sign=True)}°")
        head = f"{label} {phase.start_s:.1f} to {phase.end_s:.1f} s"
        return f"{head} ({', '.join(moved)})" if moved else head

    def _reasons(self, pulls: Sequence[Pull]) -> str:
        strongest = max((abs(pull.mean_mV) for pull in pulls), default=0.0)
        strong = [p for p in pulls if abs(p.mean_mV) >= max(LEAST_MV, LEAST_SHARE * strongest)]
        up = [p for p in strong if p.mean_mV > 0][:MOST]
        down = [p for p in strong if p.mean_mV < 0][:MOST]
        clauses = []
        if up:
            clauses.append(f"driven by {self._list(up)}")
        if down:
            clauses.append(f"{'against' if up else 'held down by'} {self._list(down)}")
        return ", " + " ".join(clauses) if clauses else ", left to its leak"

    def _list(self, pulls: Sequence[Pull]) -> str:
        return " and ".join(f"{self._name(pull.neuron)} ({_mv(pull.mean_mV, sign=True)})" for pull in pulls)

    def _name(self, neuron: str) -> str:
        """Return a neuron's name, with what it senses."""
        return f"{neuron} [{self._senses[neuron]}]" if neuron in self._senses else neuron


def _mv(value: float, sign: bool = False) -> str:
    return f"{_number(value, sign)} mV"


def _number(value: float, sign: bool = False) -> str:
    """Return a whole number with a minus as it is printed; signs in front of a zero say nothing."""
    whole = round(value)
    return f"{whole:+d}".replace("-", "−") if sign and whole else f"{whole:d}".replace("-", "−")
