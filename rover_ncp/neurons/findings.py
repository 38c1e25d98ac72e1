"""Findings about one run of a circuit: phases with a sentence each."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rover_ncp.neurons.layout import labels
from rover_ncp.neurons.phases import STILL, ExplainedPhase, Mean, Phase, explain
from rover_ncp.neurons.trace import Trace

WEAK_MV, WEAK_SHARE = 1.0, 0.15
"""A sentence omits pulls below either limit; the second is a share of the strongest pull."""
NAMED = 2
"""Most neurons that a sentence names on either side."""


@dataclass(frozen=True, eq=False)
class Findings:
    """A run's circuit explained."""

    trace: Trace
    phases: tuple[ExplainedPhase, ...]


def analyse(*traces: Trace) -> Findings:
    """Explain the runs of a drive, one behind the other; the trace is that of the last run."""
    told = [phase for trace in traces for phase in _told(trace, explain(trace))]
    return Findings(trace=traces[-1], phases=tuple(told))


def _told(trace: Trace, phases: Sequence[ExplainedPhase]) -> list[ExplainedPhase]:
    """Return phases with their sentences."""
    sensing = trace.policy.sensing.neurons
    # Without an output layer, the phase's label says what its motor neuron does.
    named = {
        neuron: label
        for neuron, label in labels(trace.policy).items()
        if neuron in sensing or trace.policy.output_layer is not None
    }
    return [phase.model_copy(update={"sentence": sentence(phase, named, sensing)}) for phase in phases]


def sentence(explained: ExplainedPhase, labels: Mapping[str, str], sensory: Collection[str]) -> str:
    """Describe a phase in one or two sentences; ``labels`` are inputs and outputs of neurons."""

    def named(neuron: str) -> str:
        return f"{neuron} [{labels[neuron]}]" if neuron in labels else neuron

    def listed(pulls: Sequence[Mean]) -> str:
        return " and ".join(f"{named(pull.neuron)} ({_mv(pull.mean_mV, '+.0f')})" for pull in pulls[:NAMED])

    motor = f"{named(explained.motor.neuron)} at {_mv(explained.motor.mean_mV)}"
    text = f"{_head(explained)}: "
    if explained.by_leak:
        text += f"{motor} by its own leak"
    if explained.behind is not None:
        text += ", " if explained.by_leak else ""
        opening = "" if explained.opening is None else f"; its synapse {100 * explained.opening:.0f} % open"
        text += f"{named(explained.behind.neuron)} ({_mv(explained.behind.mean_mV)}{opening}), "
        strongest = max(abs(pull.mean_mV) for pull in explained.pulls) if explained.pulls else 0.0
        strong = [p for p in explained.pulls if abs(p.mean_mV) >= max(WEAK_MV, WEAK_SHARE * strongest)]
        up, down = [p for p in strong if p.mean_mV > 0], [p for p in strong if p.mean_mV < 0]
        clauses = [f"driven by {listed(up)}"] if up else []
        clauses += [f"{'against' if up else 'held down by'} {listed(down)}"] if down else []
        alone = "set by its input" if explained.behind.neuron in sensory else "left to its leak"
        text += " ".join(clauses) or alone
    if not explained.by_leak:
        text += f"; it puts {motor}"
    text += "."
    if explained.behind is not None and (change := explained.change) is not None:
        verb = "grew" if abs(change.now_mV) > abs(change.before_mV) else "fell"
        text += (
            f" What changed: the pull of {named(change.neuron)} on {explained.behind.neuron} {verb} "
            f"from {_mv(change.before_mV, '+.0f')} to {_mv(change.now_mV, '+.0f')}."
        )
    return text


def _head(phase: Phase) -> str:
    head = f"{phase.label.capitalize()} {phase.start_s:.1f} to {phase.end_s:.1f} s"
    moved = [f"{phase.driven_m:.2f} m"] if phase.driven_m >= STILL[0] else []
    if abs(phase.turned_rad) >= STILL[1]:
        moved.append(f"{number(float(np.degrees(phase.turned_rad)), '+.0f')}°")
    return f"{head} ({', '.join(moved)})" if moved else head


def number(value: float, spec: str = ".4g") -> str:
    """Return a number in a format, with a typographic minus; zero has no sign."""
    text = f"{value:{spec}}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def _mv(value: float, spec: str = ".0f") -> str:
    return f"{number(value, spec)} mV"
