"""The paper's searches, literally: slow, and written to be read beside the paper.

``evaluate`` returns f(theta) of fresh rollouts. Every function yields the incumbent and its value after each
iteration. The tests compare them with the fast searches (``paper/search.py``).
"""

from typing import NamedTuple

import numpy as np


class Kind(NamedTuple):
    """The published code's numbers of one parameter kind: changes and noise at the start, caps, noise."""

    start_changes: int
    start_noise: float
    first_cap: int
    min_cap: int
    max_cap: int
    noise: tuple[float, float]


# The scripts of parking, pendulum and half-cheetah; of mountain car; of cart-pole (commit 529dae8).
PENDULUM = {
    "weight": Kind(15, 0.5, 4, 4, 12, (0.01, 0.4)),
    "sigma": Kind(10, 0.2, 3, 3, 8, (0.01, 0.05)),
    "leak_potential": Kind(8, 8.0, 2, 2, 6, (0.1, 3.0)),
    "leak": Kind(8, 0.2, 2, 2, 6, (0.05, 0.5)),
    "capacitance": Kind(10, 0.1, 2, 2, 4, (0.01, 0.1)),
    # Ours: numbers that are drawn for the layers before those of the half-cheetah's script replace them.
    "input_layer": Kind(15, 0.5, 4, 4, 12, (0.01, 0.4)),
    "output_layer": Kind(15, 0.5, 4, 4, 12, (0.01, 0.4)),
}
MOUNTAIN_CAR = {
    "weight": Kind(15, 0.5, 6, 6, 16, (0.01, 0.8)),
    "sigma": Kind(10, 0.2, 5, 5, 12, (0.01, 0.08)),
    "leak_potential": Kind(8, 8.0, 5, 4, 8, (0.1, 3.0)),
    "leak": Kind(8, 0.2, 4, 4, 8, (0.05, 0.8)),
    "capacitance": Kind(10, 0.1, 4, 4, 7, (0.01, 0.3)),
}
CART_POLE = {
    "weight": Kind(15, 0.5, 4, 5, 12, (0.03, 0.3)),
    "sigma": Kind(10, 0.2, 3, 3, 8, (0.01, 0.05)),
    "leak_potential": Kind(8, 8.0, 2, 3, 8, (0.1, 2.0)),
    "leak": Kind(8, 0.2, 2, 2, 6, (0.02, 0.2)),
    "capacitance": Kind(10, 0.1, 2, 2, 4, (0.01, 0.1)),
}


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
    evaluate,
    defaults,
    lower,
    upper,
    blocks,
    kinds,
    rng,
    iterations,
    *,
    estimates="in",
    falls_back=None,
    layers=(),
):
    """The search of the published code for circuits.

    ``blocks``: the entries of each kind. ``layers``: entries of linear layers, which all change each time.
    ``estimates``: after 51 failures the incumbent is estimated anew "in" that iteration, in its "own" one, or
    never (None). ``falls_back``: the weights' cap from which it falls instead of growing, and to which.
    """
    theta, every = defaults.copy(), list(layers)
    for block, kind in zip(blocks, kinds, strict=True):
        picked = rng.integers(block.start, block.stop, kind.start_changes)
        for entry, noise in zip(picked, rng.normal(0.0, kind.start_noise, kind.start_changes), strict=True):
            theta[entry] += noise
    theta = np.clip(theta, lower, upper)
    theta[every] = np.clip(rng.standard_normal(len(every)), lower[every], upper[every])
    caps = [kind.first_cap for kind in kinds]
    value, failures, done = evaluate(theta), 0, 0
    while done < iterations:
        counts = rng.integers(0, caps, endpoint=True)
        shares = rng.random(len(kinds))
        deviations = [
            kind.noise[0] + (kind.noise[1] - kind.noise[0]) * s for kind, s in zip(kinds, shares, strict=True)
        ]
        first = np.repeat([block.start for block in blocks], counts)
        last = np.repeat([block.stop for block in blocks], counts)
        entries, noise = rng.integers(first, last), np.repeat(deviations, counts)
        candidate = theta.copy()
        for entry, change in zip(entries, noise * rng.standard_normal(len(entries)), strict=True):
            candidate[entry] += change
        candidate = np.clip(candidate, lower, upper)
        candidate[every] = np.clip(theta[every] + rng.standard_normal(len(every)), lower[every], upper[every])
        new = evaluate(candidate)
        done += 1
        if new > value:
            theta, value, failures = candidate, new, 0
            caps = [max(cap - 1, kind.min_cap) for cap, kind in zip(caps, kinds, strict=True)]
        else:
            failures += 1
            if failures == 51:
                failures = 0
                if estimates == "own":
                    yield theta, value
                    done += 1
                if estimates:
                    value = evaluate(theta)
                weights, falls = caps[0], falls_back or (None, None)
                caps = [min(cap + 1, kind.max_cap) for cap, kind in zip(caps, kinds, strict=True)]
                if weights == falls[0]:
                    caps[0] = falls[1]
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
                value = evaluate(theta)
        yield theta, value
