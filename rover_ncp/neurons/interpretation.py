"""Contributions between neurons and time constants of a run.

Contributions follow Definition 1 of Hasani et al. (ICRA 2020): two potentials a(t) and b(t) draw a curve in
the plane (a, b). The angle Omega = arctan(db / da) between consecutive points is positive where b changes in
the direction of a. Where a is constant and b changes, the slope is vertical and has the sign of db. Vertical
slopes give little evidence of a's influence, so they are also counted separately.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from rover_ncp.circuit.circuit import Circuit, time_constants
from rover_ncp.core.config import ResultModel
from rover_ncp.neurons.layout import layers
from rover_ncp.neurons.phases import Phase
from rover_ncp.neurons.trace import FloatArray, Trace

BINS = 10
"""Bins of a histogram of Omega over -pi/2..pi/2 (supplement, figure of the slopes)."""
THRESHOLD = 1.5
"""One sign must outnumber the other by this factor; the paper says "more than half" more."""
STILL_MV = 1e-5
"""Smaller differences count as constant: the paper's float32 has steps of 7.6e-6 mV at -70 mV, so it could
not record smaller changes, such as the end of an exponential approach to rest."""


class Sign(StrEnum):
    """Sign of one neuron's contribution to another over a run."""

    POSITIVE = "positive"
    ANTAGONISTIC = "antagonistic"
    PHASE_SWITCHING = "phase-switching"
    NONE = "none"
    """The destination's potential never changed: the run gives no evidence."""


SYMBOLS = {Sign.POSITIVE: "+", Sign.ANTAGONISTIC: "−", Sign.PHASE_SWITCHING: "±", Sign.NONE: "0"}


class Slopes(ResultModel):
    """Counts of Definition 1 over some ticks."""

    sign: Sign = Field(description="by Definition 1 of the paper")
    positive: int = Field(description="P, the number of points with Omega > 0")
    negative: int = Field(description="Q, the number of points with Omega < 0")
    flat: int = Field(description="points with Omega = 0: only the source changed")
    vertical: int = Field(description="vertical slopes among P + Q: only the destination changed")
    bins: tuple[int, ...] = Field(description="histogram of Omega over -pi/2..pi/2; 0 counts as positive")


class Contribution(Slopes):
    """Contribution of ``source`` to ``destination`` in a run."""

    source: str = Field(description="the neuron that acts")
    destination: str = Field(description="the neuron that it acts on")
    driving: Slopes = Field(description="without the rest at both ends of the run")


class TimeConstant(ResultModel):
    """Range of a neuron's time constant over a run."""

    neuron: str = Field(description="its name")
    lowest_s: float = Field(description="its smallest time constant")
    highest_s: float = Field(description="its largest time constant")


@dataclass(frozen=True, eq=False)
class Interpretation:
    """Contributions and time constants of one run."""

    contributions: dict[tuple[str, str], Contribution]
    """Of all ordered pairs of different neurons, by source and destination."""
    time_constants: tuple[TimeConstant, ...]
    sources: tuple[str, ...]
    """Sensory, inter and command neurons, in this order."""
    motors: tuple[str, ...]
    """Motor neurons, in the circuit's order."""


def interpret(trace: Trace, phases: Sequence[Phase]) -> Interpretation:
    """Return the contributions and time constants of a run with these phases."""
    moving = [phase for phase in phases if any(phase.signs)]
    driving = slice(moving[0].first, moving[-1].last) if moving else slice(1)
    policy, own = trace.policy, layers(trace.policy)

    def of(layer: str) -> tuple[str, ...]:
        return tuple(name for name, is_in in zip(trace.neurons, own, strict=True) if is_in == layer)

    return Interpretation(
        contributions=contributions(trace.neurons, trace.potentials, driving),
        time_constants=time_constant_ranges(policy.circuit, trace.potentials, policy.sensing.neurons),
        sources=of("sensory") + of("inter") + of("command"),
        motors=of("motor"),
    )


def slopes(a: ArrayLike, b: ArrayLike) -> Slopes:
    """Apply Definition 1 to the potentials ``a`` of a source and ``b`` of a destination, (T,) in mV.

    Positive if P > 1.5 Q, antagonistic if Q > 1.5 P, otherwise phase-switching. Points where neither
    potential changes are not counted.
    """
    da, db = _steps(a), _steps(b)
    changed = (da != 0) | (db != 0)
    da, db = da[changed], db[changed]
    # The slope of a line does not depend on the direction of travel; vertical lines keep the sign of db.
    omega = np.arctan2(np.where(da < 0, -db, db), np.abs(da))
    positive, negative = int(np.sum(omega > 0)), int(np.sum(omega < 0))
    histogram, _ = np.histogram(omega, BINS, (-np.pi / 2, np.pi / 2))
    return Slopes(
        sign=sign_of(positive, negative),
        positive=positive,
        negative=negative,
        flat=len(omega) - positive - negative,
        vertical=int(np.sum(da == 0)),
        bins=tuple(histogram.tolist()),
    )


def contributions(
    names: Sequence[str], potentials: FloatArray, driving: slice = slice(None)
) -> dict[tuple[str, str], Contribution]:
    """Return the contributions of all ordered pairs of different neurons; potentials are (T, n) in mV.

    ``driving`` are the ticks without the rest at both ends of the run.
    """
    return {
        (a, b): Contribution(
            **dict(slopes(potentials[:, i], potentials[:, j])),
            source=a,
            destination=b,
            driving=slopes(potentials[driving, i], potentials[driving, j]),
        )
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i != j
    }


def time_constant_ranges(
    circuit: Circuit, potentials: FloatArray, driven: Sequence[str] = ()
) -> tuple[TimeConstant, ...]:
    """Return the range of tau_i = C_i / (G_i + sum w g + sum gap) over potentials (T, n) in mV (Table S7).

    ``driven`` neurons, such as sensory ones, are clamped by an input and have none.
    """
    tau = np.array([time_constants(circuit, row) for row in potentials])
    return tuple(
        TimeConstant(
            neuron=name,
            lowest_s=float(tau[:, i].min()),
            highest_s=float(tau[:, i].max()),
        )
        for i, name in enumerate(circuit.neurons)
        if name not in driven and i not in circuit.held
    )


def _steps(potentials: ArrayLike) -> FloatArray:
    steps = np.diff(np.asarray(potentials, np.float64))
    steps[np.abs(steps) <= STILL_MV] = 0.0
    return steps


def sign_of(positive: int, negative: int, threshold: float = THRESHOLD) -> Sign:
    """Return the sign of counts P and Q: one must exceed the other by the factor ``threshold``."""
    if positive + negative == 0:
        return Sign.NONE
    if positive > threshold * negative:
        return Sign.POSITIVE
    if negative > threshold * positive:
        return Sign.ANTAGONISTIC
    return Sign.PHASE_SWITCHING
