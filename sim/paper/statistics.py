"""Tests of two sets of runs, each with the size of the difference that it is about, and Holm's correction."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.05
NO_GAP = "no gap is found, which does not prove that there is none"
_RESAMPLES = 9999
_SEED = 20
"""A table is the same each time."""


class Effect(NamedTuple):
    """A permutation test of two sets of runs, and how far they lie apart."""

    difference: float
    """Of the means."""
    interval: tuple[float, float]
    """Of the difference, 95 %."""
    probability: float
    """That a run of the first set has the higher value."""
    p: float

    def sentence(self, runs: int, other_runs: int) -> str:
        """Return test, n, p and effect size in a line."""
        apart = f"{_apart(self.difference, self.interval)}, P(above) {self.probability:.2f}"
        return f"{apart}; permutation test, n = {runs} and {other_runs}, p = {self.p:.2g}"


class Summary(NamedTuple):
    """Mean and standard deviation of a number of runs."""

    mean: float
    std: float
    runs: int


class Difference(NamedTuple):
    """A test of summaries or of rates."""

    test: str
    runs: tuple[int, int]
    difference: float
    interval: tuple[float, float]
    """Of the difference, 95 %."""
    p: float

    def sentence(self) -> str:
        """Return test, n, p and effect size in a line."""
        apart = _apart(self.difference, self.interval)
        return f"{apart}; {self.test}, n = {self.runs[0]} and {self.runs[1]}, p = {self.p:.2g}"


def _apart(difference: float, interval: tuple[float, float]) -> str:
    return f"difference {mean_text(difference)} ({interval_text(interval)})"


def measure(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> Effect:
    """Compare two sets of values, (n,) and (m,)."""
    from scipy.stats import bootstrap, mannwhitneyu, permutation_test

    if np.ptp(np.concatenate([ours, theirs])) == 0.0:
        return Effect(0.0, (0.0, 0.0), 0.5, 1.0)
    rng = np.random.default_rng(_SEED)
    test = permutation_test((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng)
    ends = bootstrap((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng).confidence_interval
    above = float(mannwhitneyu(ours, theirs).statistic) / (len(ours) * len(theirs))
    return Effect(float(test.statistic), (float(ends.low), float(ends.high)), above, float(test.pvalue))


def _difference(a: NDArray[np.float64], b: NDArray[np.float64], axis: int = -1) -> Any:
    return a.mean(axis=axis) - b.mean(axis=axis)


def welch(ours: Summary, theirs: Summary) -> Difference:
    """Compare two means by Welch's test."""
    from scipy.stats import t

    squares = [each.std**2 / each.runs for each in (ours, theirs)]
    difference, error = ours.mean - theirs.mean, float(np.sqrt(sum(squares)))
    margin, p = 0.0, float(difference == 0.0)
    if error > 0.0:
        freedom = error**4 / sum(
            square**2 / (each.runs - 1) for square, each in zip(squares, (ours, theirs), strict=True)
        )
        margin = error * float(t.ppf(1.0 - LEVEL / 2.0, freedom))
        p = 2.0 * float(t.sf(abs(difference) / error, freedom))
    interval = (difference - margin, difference + margin)
    return Difference("Welch's test", (ours.runs, theirs.runs), difference, interval, p)


def fisher(hits: int, of: int, their_hits: int, their_of: int) -> Difference:
    """Compare two rates by Fisher's test; the interval is Newcombe's (1998, method 10), of Wilson's two."""
    from scipy.stats import binomtest, fisher_exact

    p = float(fisher_exact([[hits, of - hits], [their_hits, their_of - their_hits]]).pvalue)
    ours, theirs = hits / of, their_hits / their_of
    low, high = binomtest(hits, of).proportion_ci(method="wilson")
    their_low, their_high = binomtest(their_hits, their_of).proportion_ci(method="wilson")
    interval = (
        ours - theirs - float(np.hypot(ours - low, their_high - theirs)),
        ours - theirs + float(np.hypot(high - ours, theirs - their_low)),
    )
    return Difference("Fisher's test", (of, their_of), ours - theirs, interval, p)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number (Holm 1979)."""
    order = np.argsort(p_values)
    scaled = np.array(p_values)[order] * np.arange(len(order), 0, -1)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return [float(p) for p in corrected]


def mean_text(mean: float | None, std: float | None = None) -> str:
    """Return a mean, and its deviation, with the digits of its size."""
    if mean is None:
        return ""
    if abs(mean) >= 10_000:  # a number of steps
        return f"{mean:,.0f}"
    digits = 1 if abs(mean) >= 10 else 3
    spread = "" if std is None else f" ± {std:.{digits}f}"
    return f"{mean:.{digits}f}{spread}"


def interval_text(interval: tuple[float, float]) -> str:
    """Return an interval with the digits of its size."""
    return " .. ".join(map(mean_text, interval))
