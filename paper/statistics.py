"""Tests of two sets of runs with effect sizes, and Holm's correction."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from rover_ncp.course.reference import FloatArray

LEVEL = 0.05


class Estimate(NamedTuple):
    """A value with its 95 % interval; of a difference also p, the probability of one so large by chance."""

    value: float
    low: float
    high: float
    p: float = 1.0

    def within(self, margin: float) -> bool:
        """Whether the whole interval is nearer to 0 than a margin."""
        return self.low > -margin and self.high < margin

    def text(self) -> str:
        """Return the value and its interval."""
        return f"{mean_text(self.value)} [{mean_text(self.low)}, {mean_text(self.high)}]"


def mean_interval(values: FloatArray) -> Estimate:
    """Return the mean of two or more values (n,)."""
    found = stats.ttest_1samp(values, 0.0)
    return Estimate(float(np.mean(values)), *map(float, found.confidence_interval(1.0 - LEVEL)))


def welch(ours: FloatArray, theirs: FloatArray) -> Estimate:
    """Return the difference of two means, by Welch's test."""
    found = stats.ttest_ind(ours, theirs, equal_var=False)
    low, high = found.confidence_interval(1.0 - LEVEL)
    return Estimate(float(np.mean(ours) - np.mean(theirs)), float(low), float(high), float(found.pvalue))


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate."""
    interval = stats.binomtest(hits, of).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def fisher(hits: int, of: int, their_hits: int, their_of: int) -> Estimate:
    """Return the difference of two rates, by Fisher's test.

    The interval is Newcombe's (1998, method 10), of Wilson's two.
    """
    p = float(stats.fisher_exact([[hits, of - hits], [their_hits, their_of - their_hits]]).pvalue)
    ours, theirs = hits / of, their_hits / their_of
    (low, high), (their_low, their_high) = wilson(hits, of), wilson(their_hits, their_of)
    down, up = np.hypot(ours - low, their_high - theirs), np.hypot(high - ours, theirs - their_low)
    return Estimate(ours - theirs, float(ours - theirs - down), float(ours - theirs + up), p)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number (Holm 1979)."""
    order = np.argsort(p_values)
    scaled = np.array(p_values)[order] * np.arange(len(order), 0, -1)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return [float(p) for p in corrected]


def mean_text(mean: float, std: float | None = None) -> str:
    """Return a mean, and its deviation, with the digits of its size."""
    digits = 1 if abs(mean) >= 10 else 3
    spread = "" if std is None else f" ± {std:.{digits}f}"
    return f"{mean:.{digits}f}{spread}"
