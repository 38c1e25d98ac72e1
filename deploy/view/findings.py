"""Findings about one run of a circuit: phases, contributions and time constants."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from deploy.view.interpretation import (
    PUBLISHED_SIGNS,
    PUBLISHED_TIME_CONSTANTS_S,
    Contribution,
    TimeConstant,
    contributions,
    time_constant_ranges,
)
from deploy.view.layout import labels, layers
from deploy.view.phases import Explanation, explain
from deploy.view.sentences import sentence
from deploy.view.trace import Trace


@dataclass(frozen=True, eq=False)
class Findings:
    """A run's circuit explained."""

    trace: Trace
    contributions: dict[tuple[str, str], Contribution]
    """Definition 1 over the whole run, for all pairs."""
    driving: dict[tuple[str, str], Contribution]
    """The same without the rest at both ends of the run, where most potentials are constant."""
    time_constants: tuple[TimeConstant, ...]
    explanations: tuple[Explanation, ...]
    sentences: tuple[str, ...]
    """One for each explanation."""

    @property
    def motors(self) -> tuple[str, ...]:
        """The motor neurons, in the circuit's order."""
        return self._of("motor")

    @property
    def sources(self) -> tuple[str, ...]:
        """Sensory, inter and command neurons, in this order."""
        return self._of("sensory") + self._of("inter") + self._of("command")

    def fields(self, pairs: Iterable[tuple[str, str]]) -> dict[str, Any]:
        """Return the findings as plain values, with the contributions of some pairs."""
        return {
            #: with --task by the signs of the outputs, and times are the circuit's
            "phases": [_phase(*both) for both in zip(self.explanations, self.sentences, strict=True)],
            "contributions": [  #: of sensory, inter and command neurons to motor neurons
                {
                    **vars(self.contributions[pair]),
                    "driving": {  #: the same without the rest at both ends of the run
                        name: getattr(self.driving[pair], name) for name in ("sign", "positive", "negative")
                    },
                    "paper": PUBLISHED_SIGNS.get(pair),  #: the paper's sign
                }
                for pair in pairs
            ],
            "time_constants": [  #: in the run; paper_s is the paper's range
                {**row._asdict(), "paper_s": PUBLISHED_TIME_CONSTANTS_S.get(row.neuron)}
                for row in self.time_constants
            ],
        }

    def _of(self, layer: str) -> tuple[str, ...]:
        own = layers(self.trace.policy)
        return tuple(name for name, is_in in zip(self.trace.neurons, own, strict=True) if is_in == layer)


def analyse(trace: Trace) -> Findings:
    """Explain a run."""
    explanations = explain(trace)
    moving = [each.phase for each in explanations if any(each.phase.signs)]
    potentials, sensing = trace.potentials, trace.policy.sensing.neurons
    driving = potentials[moving[0].first : moving[-1].last] if moving else potentials[:1]
    # Without an output layer, the phase's label says what its motor neuron does.
    named = {
        neuron: label
        for neuron, label in labels(trace.policy).items()
        if neuron in sensing or trace.policy.output_layer is not None
    }
    return Findings(
        trace=trace,
        contributions=contributions(trace.neurons, potentials),
        driving=contributions(trace.neurons, driving),
        time_constants=time_constant_ranges(trace.policy.circuit, potentials, sensing),
        explanations=explanations,
        sentences=tuple(sentence(each, named, sensing) for each in explanations),
    )


def _phase(explained: Explanation, text: str) -> dict[str, Any]:
    phase = explained.phase
    return {
        "label": phase.label,
        "start_s": phase.start_s,
        "end_s": phase.end_s,
        "driven_m": phase.driven_m,  #: length of the path
        "turned_rad": phase.turned_rad,  #: to the left
        "motor": explained.motor._asdict(),  #: motor neuron with the largest share in the output
        "rival": explained.rival._asdict() if explained.rival else None,
        "behind": explained.behind._asdict() if explained.behind else None,  #: pulls most on it
        "by_leak": explained.by_leak,  #: whether the leak alone determines the motor neuron's potential
        "opening": explained.opening,  #: of the synapse of `behind`, 0 to 1; null for a gap junction
        "pulls": [pull._asdict() for pull in explained.pulls],  #: on the neuron behind, the strongest first
        "change": explained.change._asdict() if explained.change else None,  #: the pull that changed most
        "sentence": text,  #: all this in words
    }
