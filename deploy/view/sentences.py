"""The sentence for each phase of a manoeuvre."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from deploy.view.phases import Explanation, Mean, Phase

WEAK_MV, WEAK_SHARE = 1.0, 0.15
"""A sentence omits pulls below either limit; the second is a share of the strongest pull."""
NAMED = 2
"""Most neurons that a sentence names on either side."""


def sentence(explained: Explanation, labels: Mapping[str, str], sensory: Collection[str]) -> str:
    """Describe a phase in one to three sentences; ``labels`` are inputs and outputs of neurons."""

    def named(neuron: str) -> str:
        return f"{neuron} [{labels[neuron]}]" if neuron in labels else neuron

    def listed(pulls: Sequence[Mean]) -> str:
        return " and ".join(f"{named(pull.neuron)} ({_mv(pull.mean_mV, '+.0f')})" for pull in pulls[:NAMED])

    motor = f"{named(explained.motor.neuron)} at {_mv(explained.motor.mean_mV)}"
    text = f"{_head(explained.phase)}: "
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
    if explained.rival is not None:
        text += f"; against it {named(explained.rival.neuron)} at {_mv(explained.rival.mean_mV)}"
    text += "."
    if explained.behind is not None and (change := explained.change) is not None:
        verb = "grew" if abs(change.now_mV) > abs(change.before_mV) else "fell"
        text += (
            f" What changed: the pull of {named(change.neuron)} on {explained.behind.neuron} {verb} "
            f"from {_mv(change.before_mV, '+.0f')} to {_mv(change.now_mV, '+.0f')}."
        )
    if explained.swinging:
        swings = [f"{row.neuron} (by {_mv(row.mean_mV)})" for row in explained.swinging[:NAMED]]
        text += f" From tick to tick {' and '.join(swings)} {'swings' if len(swings) == 1 else 'swing'}."
    return text


def _head(phase: Phase) -> str:
    head = f"{phase.label.capitalize()} {phase.start_s:.1f} to {phase.end_s:.1f} s"
    moved = [f"{phase.driven_m:.2f} m"] if phase.driven_m >= 0.005 else []
    if abs(degrees := float(np.degrees(phase.turned_rad))) >= 0.5:
        moved.append(f"{number(degrees, '+.0f')}°")
    return f"{head} ({', '.join(moved)})" if moved else head


def number(value: float, spec: str = ".4g") -> str:
    """Return a number in a format, with a typographic minus; zero has no sign."""
    text = f"{value:{spec}}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def _mv(value: float, spec: str = ".0f") -> str:
    return f"{number(value, spec)} mV"
