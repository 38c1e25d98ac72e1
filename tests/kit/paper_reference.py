"""The paper's searches, literally: slow, and written to be read beside the paper.

``evaluate`` returns f(theta) of fresh rollouts. Every function yields the incumbent and its value after each
iteration. The tests compare them with the fast searches (``sim/paper/search/published.py``).
"""

from typing import NamedTuple

import numpy as np


class Kind(NamedTuple):
    """The entries of one parameter kind, the noise at the start, and the published code's numbers."""

    entries: slice
    start_changes: int
    start_noise: float
    min_cap: int
    max_cap: int
    noise: tuple[float, float]


def algorithm1(evaluate, start, lower, upper, rng, iterations, sigma, alpha, failures):
    """Algorithm 1 as printed; ``failures`` is the paper's N, sigma a share of each parameter's range."""
    theta, value, i = start, evaluate(start), 0
    for _ in range(iterations):
        candidate = np.clip(theta + sigma * (upper - lower) * rng.standard_normal(len(theta)), lower, upper)
        new = evaluate(candidate)
        if new > value:
            theta, value, i = candidate, new, 0
            sigma = sigma * alpha
        else:
            sigma = sigma / alpha
        i = i + 1
        if i > failures:
            value = evaluate(theta)
        yield theta, value


def published_circuit_search(
    evaluate, defaults, lower, upper, kinds, rng, iterations, *, estimates_again, falls_back=None, layers=()
):
    """The search of the published code for circuits.

    ``estimates_again``: after 51 failures the incumbent is estimated anew, which takes an iteration.
    ``falls_back``: by kind, the cap from which a growing cap falls, and to which.
    ``layers``: entries of linear layers, which all change in every iteration.
    """
    theta, every = defaults.copy(), list(layers)
    for kind in kinds:
        picked = rng.integers(kind.entries.start, kind.entries.stop, kind.start_changes)
        for entry, noise in zip(picked, rng.normal(0.0, kind.start_noise, kind.start_changes), strict=True):
            theta[entry] += noise
    theta = np.clip(theta, lower, upper)
    theta[every] = np.clip(rng.standard_normal(len(every)), lower[every], upper[every])
    caps = [kind.min_cap for kind in kinds]
    value, failures = evaluate(theta), 0
    for _ in range(iterations):
        if failures == 51:
            if estimates_again:
                value = evaluate(theta)
            fallen = falls_back or {}
            for number, kind in enumerate(kinds):
                top, bottom = fallen.get(number, (None, 0))
                caps[number] = bottom if caps[number] == top else min(caps[number] + 1, kind.max_cap)
            failures = 0
            if estimates_again:
                yield theta, value
                continue
        counts = rng.integers(0, caps, endpoint=True)
        shares = rng.random(len(kinds))
        deviations = [
            kind.noise[0] + (kind.noise[1] - kind.noise[0]) * s for kind, s in zip(kinds, shares, strict=True)
        ]
        first = np.repeat([kind.entries.start for kind in kinds], counts)
        last = np.repeat([kind.entries.stop for kind in kinds], counts)
        entries, noise = rng.integers(first, last), np.repeat(deviations, counts)
        candidate = theta.copy()
        for entry, change in zip(entries, noise * rng.standard_normal(len(entries)), strict=True):
            candidate[entry] += change
        candidate = np.clip(candidate, lower, upper)
        candidate[every] = np.clip(theta[every] + rng.standard_normal(len(every)), lower[every], upper[every])
        new = evaluate(candidate)
        if new > value:
            theta, value, failures = candidate, new, 0
            caps = [max(cap - 1, kind.min_cap) for cap, kind in zip(caps, kinds, strict=True)]
        else:
            failures += 1
        yield theta, value


def published_network_search(evaluate, size, rng, iterations):
    """The search of the published code for MLP and LSTM: one amplitude of noise on all weights."""
    amplitude = 0.01
    theta = amplitude * rng.standard_normal(size)
    value, failures = evaluate(theta), 0
    for _ in range(iterations):
        candidate = theta + amplitude * rng.standard_normal(size)
        new = evaluate(candidate)
        if new > value:
            theta, value, failures = candidate, new, 0
            amplitude = max(amplitude / 2.0, 0.01)
        else:
            failures += 1
            if failures == 51:
                amplitude, failures = min(amplitude * 5.0, 1.0), 0
        yield theta, value
