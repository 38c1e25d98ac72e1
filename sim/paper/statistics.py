"""Tests of two sets of runs with effect sizes, Holm's correction, and interquartile means."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

LEVEL = 0.05
_RESAMPLES = 9999
_PAIR_RESAMPLES = 2000
_SEED = 20


class Effect(NamedTuple):
    """A permutation test of two sets of runs, and how far they lie apart."""

    difference: float
    """Of the means."""
    interval: tuple[float, float]
    """Of the difference, 95 %."""
    p: float

    def text(self) -> str:
        """Return the difference and its interval."""
        return f"{mean_text(self.difference)} ({interval_text(self.interval)})"


class Interval(NamedTuple):
    """An estimate and its 95 % interval."""

    value: float
    low: float
    high: float

    def text(self) -> str:
        """Return the estimate and its interval."""
        return f"{mean_text(self.value)} ({interval_text((self.low, self.high))})"


class Summary(NamedTuple):
    """Mean and standard deviation of a number of runs."""

    mean: float
    std: float
    runs: int


class Difference(NamedTuple):
    """A test of summaries or of rates."""

    difference: float
    interval: tuple[float, float]
    """Of the difference, 95 %."""
    p: float


def measure(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> Effect:
    """Compare two sets of values, (n,) and (m,)."""
    from scipy.stats import bootstrap, permutation_test

    if np.ptp(np.concatenate([ours, theirs])) == 0.0:
        return Effect(0.0, (0.0, 0.0), 1.0)
    rng = np.random.default_rng(_SEED)
    test = permutation_test((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng)
    difference = float(test.statistic)
    if np.ptp(ours) == 0.0 and np.ptp(theirs) == 0.0:
        return Effect(difference, (difference, difference), float(test.pvalue))
    ends = bootstrap((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng).confidence_interval
    return Effect(difference, (float(ends.low), float(ends.high)), float(test.pvalue))


def _difference(a: NDArray[np.float64], b: NDArray[np.float64], axis: int = -1) -> Any:
    return a.mean(axis=axis) - b.mean(axis=axis)


def interquartile_mean(values: NDArray[np.float64]) -> Interval:
    """Return the mean of the middle half of values (n,) and its bootstrap interval (Agarwal et al. 2021)."""
    from scipy.stats import bootstrap, trim_mean

    def middle(rows: NDArray[np.float64], axis: int = -1) -> Any:
        return trim_mean(rows, 0.25, axis=axis)

    value = float(middle(values))
    if len(values) < 2 or np.ptp(values) == 0.0:
        return Interval(value, value, value)
    found = bootstrap(
        (values,), middle, n_resamples=_RESAMPLES, rng=np.random.default_rng(_SEED), method="percentile"
    )
    return Interval(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def improvement(
    pairs: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]],
) -> Interval:
    """Return the probability that a run of the first set beats one of the second, mean over tasks.

    Ties count half. The interval is a bootstrap within each set of each task (Agarwal et al. 2021).
    """
    rng = np.random.default_rng(_SEED)

    def above(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> Any:
        difference = ours[..., :, None] - theirs[..., None, :]
        return ((difference > 0.0) + 0.5 * (difference == 0.0)).mean(axis=(-2, -1))

    drawn = [
        above(*(values[rng.integers(0, len(values), (_PAIR_RESAMPLES, len(values)))] for values in pair))
        for pair in pairs
    ]
    low, high = np.percentile(np.mean(drawn, axis=0), [2.5, 97.5])
    return Interval(float(np.mean([above(*pair) for pair in pairs])), float(low), float(high))


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
    return Difference(difference, interval, p)


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate."""
    from scipy.stats import binomtest

    interval = binomtest(hits, of).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def fisher(hits: int, of: int, their_hits: int, their_of: int) -> Difference:
    """Compare two rates by Fisher's test; the interval is Newcombe's (1998, method 10), of Wilson's two."""
    from scipy.stats import fisher_exact

    p = float(fisher_exact([[hits, of - hits], [their_hits, their_of - their_hits]]).pvalue)
    ours, theirs = hits / of, their_hits / their_of
    low, high = wilson(hits, of)
    their_low, their_high = wilson(their_hits, their_of)
    interval = (
        ours - theirs - float(np.hypot(ours - low, their_high - theirs)),
        ours - theirs + float(np.hypot(high - ours, theirs - their_low)),
    )
    return Difference(ours - theirs, interval, p)


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
