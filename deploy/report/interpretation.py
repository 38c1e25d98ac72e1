"""Analysis of a run: contributions between neurons, and the time constant of each neuron.

Contributions follow Definition 1 of Hasani et al. (ICRA 2020): two potentials a(t) and b(t) draw a curve in
the plane (a, b); the slopes between its consecutive points, as angles Omega = arctan(db / da), say whether b
goes with a or against it. Where a is constant and b moves, the slope is vertical, and its sign is that of b's
movement. Such points give little evidence of a's influence, so they are also counted apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.circuit.solver_reference import time_constants

FloatArray = NDArray[np.float64]

BINS = 10
"""Bins of a histogram of Omega over -pi/2..pi/2 (supplement, figure of the slopes)."""
THRESHOLD = 1.5
"""One sign must outnumber the other so many times; the paper says "more than half" more."""
STILL_MV = 1e-5
"""A smaller difference is no movement: the paper's float32 has steps of 7.6e-6 mV at -70 mV, so that what
goes on below, such as the endless last approach to rest, was not there to be counted."""


class Sign(StrEnum):
    """How one neuron contributes to another over a run."""

    POSITIVE = "positive"
    ANTAGONISTIC = "antagonistic"
    PHASE_SWITCHING = "phase-switching"
    NONE = "none"
    """No potential moved up or down: the run gives no evidence."""


@dataclass(frozen=True)
class Contribution:
    """Contribution of ``source`` to ``destination`` in a run."""

    source: str
    destination: str
    positive: int
    """P, the number of points with Omega > 0."""
    negative: int
    """Q, the number of points with Omega < 0."""
    flat: int
    """Points with Omega = 0: the source moved, the destination did not."""
    vertical: int
    """How many of P + Q are vertical: the destination moved while the source stood still."""
    bins: tuple[int, ...]
    """Histogram of all Omega, in equal bins over -pi/2..pi/2; Omega = 0 falls right of the middle."""
    sign: Sign


class TimeConstant(NamedTuple):
    """The smallest and the largest time constant of a neuron over a run, in s."""

    neuron: str
    lowest_s: float
    highest_s: float


def contribution(
    source: str,
    destination: str,
    a: ArrayLike,
    b: ArrayLike,
    *,
    threshold: float = THRESHOLD,
    bins: int = BINS,
) -> Contribution:
    """Return Definition 1 for the potentials ``a`` of the source and ``b`` of the destination, (T,) in mV.

    Positive if P > threshold * Q, antagonistic if Q > threshold * P, otherwise phase-switching. Points where
    neither moves count for nothing.
    """
    da, db = _steps(a), _steps(b)
    if da.shape != db.shape:
        raise ValueError(f"two potentials over one run have as many values, got {len(da)} and {len(db)}")
    moving = (da != 0) | (db != 0)
    da, db = da[moving], db[moving]
    # The angle of a line, whichever way along it the point moved; vertical ones keep the sign of db.
    omega = np.arctan2(np.where(da < 0, -db, db), np.abs(da))
    positive, negative = int(np.sum(omega > 0)), int(np.sum(omega < 0))
    histogram, _ = np.histogram(omega, bins, (-np.pi / 2, np.pi / 2))
    return Contribution(
        source=source,
        destination=destination,
        positive=positive,
        negative=negative,
        flat=len(omega) - positive - negative,
        vertical=int(np.sum(da == 0)),
        bins=tuple(histogram.tolist()),
        sign=_sign(positive, negative, threshold),
    )


def contributions(
    names: Sequence[str], potentials: FloatArray, *, threshold: float = THRESHOLD, bins: int = BINS
) -> dict[tuple[str, str], Contribution]:
    """Return the contributions of all ordered pairs of different neurons; potentials are (T, n) in mV."""
    return {
        (a, b): contribution(a, b, potentials[:, i], potentials[:, j], threshold=threshold, bins=bins)
        for i, a in enumerate(names)
        for j, b in enumerate(names)
        if i != j
    }


def time_constant_ranges(
    circuit: Circuit, potentials: FloatArray, driven: Sequence[str] = ()
) -> tuple[TimeConstant, ...]:
    """Return the range of tau_i = C_i / (G_i + sum w g + sum gap) over potentials (T, n) in mV (Table S7).

    ``driven`` neurons, such as sensory ones, are set from outside and have none.
    """
    tau = np.array([time_constants(circuit, row) for row in potentials])
    return tuple(
        TimeConstant(name, float(tau[:, i].min()), float(tau[:, i].max()))
        for i, name in enumerate(circuit.neurons)
        if name not in driven and i not in circuit.held
    )


def _steps(potentials: ArrayLike) -> FloatArray:
    values = np.asarray(potentials, np.float64)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ValueError("potentials of one neuron are a row of finite numbers")
    steps = np.diff(values)
    steps[np.abs(steps) <= STILL_MV] = 0.0
    return steps


def _sign(positive: int, negative: int, threshold: float) -> Sign:
    if positive + negative == 0:
        return Sign.NONE
    if positive > threshold * negative:
        return Sign.POSITIVE
    if negative > threshold * positive:
        return Sign.ANTAGONISTIC
    return Sign.PHASE_SWITCHING
