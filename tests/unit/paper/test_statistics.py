"""Tests of two sets of runs, intervals and corrections, against textbooks."""

import numpy as np
import pytest

from paper.statistics import fisher, holm, welch


def test_holms_correction_is_that_of_the_textbook():
    # Holm (1979): 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1, never falling.
    assert holm([0.01, 0.04, 0.03, 0.02]) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert holm([0.4, 0.9]) == pytest.approx([0.8, 0.9])
    assert holm([]) == []


def test_interval_of_a_difference_of_rates_is_newcombes():
    # Newcombe (1998), method 10, example (a): 56 of 70 and 48 of 80.
    found = fisher(56, 70, 48, 80)
    assert found.value == pytest.approx(0.2)
    assert (found.low, found.high) == pytest.approx((0.0524, 0.3339), abs=5e-5)


def with_moments(mean, variance, count):
    """Return values of a mean and a variance."""
    values = np.arange(float(count))
    return mean + (values - values.mean()) / values.std(ddof=1) * variance**0.5


def test_welchs_test_is_that_of_the_textbook():
    # t = (20.6 - 22.1) / sqrt(3.0 / 10 + 6.5 / 10), 15.9 degrees of freedom, whose quantile is 2.121.
    found = welch(with_moments(20.6, 3.0, 10), with_moments(22.1, 6.5, 10))
    assert found.p == pytest.approx(0.143, abs=0.002)
    assert (found.low, found.high) == pytest.approx(
        (-1.5 - 2.121 * 0.95**0.5, -1.5 + 2.121 * 0.95**0.5), abs=0.002
    )
