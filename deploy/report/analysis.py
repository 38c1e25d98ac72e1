"""Analysis of one run's circuit in one value; tables, pictures and pages use it."""

from dataclasses import dataclass

from deploy.report.interpretation import (
    THRESHOLD,
    Contribution,
    TimeConstant,
    contributions,
    time_constant_ranges,
)
from deploy.report.layout import Layer, layers
from deploy.report.sentences import Explanation, explain
from deploy.report.trace import Trace


@dataclass(frozen=True, eq=False)
class Analysis:
    """A run's circuit explained."""

    trace: Trace
    threshold: float
    contributions: dict[tuple[str, str], Contribution]
    """Definition 1 over the whole run, for all pairs."""
    driving: dict[tuple[str, str], Contribution]
    """The same without the standing still at both ends, where little but rounding and rest is left."""
    time_constants: tuple[TimeConstant, ...]
    explanations: tuple[Explanation, ...]

    @property
    def motors(self) -> tuple[str, ...]:
        """The motor neurons, in the circuit's order."""
        return self._in(Layer.MOTOR)

    @property
    def sources(self) -> tuple[str, ...]:
        """Sensory, inter and command neurons, in this order."""
        return self._in(Layer.SENSORY) + self._in(Layer.INTER) + self._in(Layer.COMMAND)

    def _in(self, layer: Layer) -> tuple[str, ...]:
        own = layers(self.trace.policy)
        return tuple(name for name, is_in in zip(self.trace.neurons, own, strict=True) if is_in is layer)


def analyse(trace: Trace, threshold: float = THRESHOLD) -> Analysis:
    """Explain a run. The policy's outputs must be v and omega."""
    explanations = explain(trace)
    moving = [each.phase for each in explanations if any(each.phase.signs)]
    potentials = trace.potentials
    driving = potentials[moving[0].first : moving[-1].last] if moving else potentials[:1]
    return Analysis(
        trace=trace,
        threshold=threshold,
        contributions=contributions(trace.neurons, potentials, threshold=threshold),
        driving=contributions(trace.neurons, driving, threshold=threshold),
        time_constants=time_constant_ranges(trace.policy.circuit, potentials, trace.policy.sensing.neurons),
        explanations=explanations,
    )
