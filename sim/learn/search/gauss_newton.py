"""Damped Gauss-Newton descents on the residuals of every checkpoint, from many starts.

A return is one number. Its residuals are three numbers for each checkpoint: the errors in x, y and heading.

1. Samples are drawn around the untuned start, and the best one starts a descent.
2. Finite differences measure how each parameter changes the residuals (the slopes).
3. The descent makes damped Gauss-Newton steps. A batch holds one step, close to the goal two with different
   damping, and the finite difference of one parameter, each parameter in its turn. The outcome of a step
   corrects the slopes (Broyden). Damping follows success and failure (Levenberg, Marquardt).
4. A descent ends when it gains little over a window of steps, or is too slow to overtake the best. The next
   one starts from restarts, which are copies of a good point with some parameters moved far, or from new
   samples.

Three rules lead past the local optima of a course:

* Far from the goal a descent climbs the ``survival``, not the return: how far the rover gets before it goes
  astray. Residuals after a wrong turn are no information about the turn.
* A descent that stalls there looks for dead parameters and revives them (``descent``).
* Restarts that gain nothing are followed by samples. Where the best is good, restarts are wide and many.
  Their later batches race against the best of the first, and a candidate that loses is truncated.

All candidates count as iterations, those that measure slopes too. No decision depends on the residuals of a
truncated candidate behind the checkpoint where it was truncated.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search import Batch, Scores, Search
from sim.learn.search.descent import CONSTANTS, Descent
from sim.learn.search.least_squares import LeastSquares, ScoredPoint, scored
from sim.learn.search.unit_box import UnitBox, Vector, reflected

_FoundT = TypeVar("_FoundT")
_Part: TypeAlias = Generator[Batch, Scores, _FoundT]
"""A part of the search: it evaluates candidates and returns what it found."""


def search(
    layout: ParameterLayout, defaults: Vector, rng: np.random.Generator, inert: NDArray[np.bool_]
) -> Search:
    """Search from the defaults (P,); inert parameters (P,) keep them."""
    return gauss_newton(UnitBox.of(layout, defaults, inert), rng)


def gauss_newton(box: UnitBox, rng: np.random.Generator) -> Search:
    """Maximise a return made of residuals: minus the sum of their squares."""
    tried, draw = _Tried(box), _Draw(box, rng)
    [last] = yield from tried.evaluate(box.start[None])
    origin: _Origin | None = None
    restarted = False
    while True:
        checkpoints = len(last.residuals)
        origin = _next_origin(last, tried.best, origin if restarted else None)
        restarted = _restarts(tried.best, origin, checkpoints)
        if restarted:
            samples = yield from _race(tried, draw, origin.at, checkpoints)
        else:
            samples = yield from tried.evaluate(draw.samples())
        last = yield from _descend(tried, draw, samples, origin.at if restarted else None)


class _Tried:
    """Evaluates points of the unit box; knows the best of them."""

    def __init__(self, box: UnitBox) -> None:
        self._box = box
        self._best: ScoredPoint | None = None
        self.count = 0

    @property
    def best(self) -> ScoredPoint:
        """The best outcome; the first of equals."""
        assert self._best is not None  # the start is evaluated first
        return self._best

    def evaluate(self, points: Vector, to_beat: Sequence[float] = ()) -> _Part[list[ScoredPoint]]:
        """Return the outcomes of points (n, D); those below their ``to_beat`` may be truncated."""
        thresholds = np.array(to_beat or [-math.inf] * len(points))
        scores = yield Batch(self._box.vectors(points), thresholds)
        values = scores.returns.tolist()
        if any(map(math.isnan, values)):
            raise ValueError("a return is not a number")
        # A copy, because an evaluator may use its array again.
        found = scored(points, values, scores.residuals.copy())
        self.count += len(points)
        highest = max(values)
        if self._best is None or highest > self._best.value:
            self._best = found[values.index(highest)]
        return found


def _highest(outcomes: list[ScoredPoint]) -> ScoredPoint:
    """Return the outcome of the highest return, the first of equals."""
    return max(outcomes, key=lambda outcome: outcome.value)


class _Draw:
    """Draws points of the unit box."""

    def __init__(self, box: UnitBox, rng: np.random.Generator) -> None:
        self._box, self._rng = box, rng

    def samples(self) -> Vector:
        """Draw points around the untuned start."""
        moves = self._rng.standard_normal((CONSTANTS.samples, self._box.size))
        return reflected(self._box.start + CONSTANTS.sample_spread * moves)

    def restarts(self, origin: Vector, *, wide: bool) -> Vector:
        """Draw copies of a point (D,) with some parameters moved far."""
        share = CONSTANTS.wide_restart_share if wide else CONSTANTS.restart_share
        moved = self._rng.random((CONSTANTS.restarts, self._box.size)) < share
        moves = CONSTANTS.restart_spread * self._rng.standard_normal(moved.shape)
        return reflected(origin + np.where(moved, moves, 0.0))

    def probes(self, point: Vector) -> Vector:
        """Return a point (D,) with each parameter moved a little, alone: (D, D)."""
        probes: Vector = np.tile(point, (self._box.size, 1))
        for parameter, probe in enumerate(probes):
            self.move(probe, parameter)
        return probes

    def move(self, probe: Vector, parameter: int) -> None:
        """Move one parameter of a point (D,), up or down, within the box."""
        here = float(probe[parameter])
        there = here + (CONSTANTS.probe if self._rng.random() < 0.5 else -CONSTANTS.probe)
        probe[parameter] = there if 0.0 <= there <= 1.0 else 2.0 * here - there


@dataclass
class _Origin:
    """Where restarts begin."""

    at: ScoredPoint
    without_gain: int = 0
    """Restarts since the last gain."""


def _next_origin(last: ScoredPoint, best: ScoredPoint, restarted_from: _Origin | None) -> _Origin:
    """Return the origin of further restarts, ``last`` being where a descent ended.

    ``restarted_from`` is the origin of that descent, None if it began at samples.
    """
    if _is_good(best, len(last.residuals)):
        return _Origin(best)
    if restarted_from is None:
        return _Origin(best if last.value < CONSTANTS.near_best * best.value else last)
    before = restarted_from.at.value
    if last.value > (1.0 - CONSTANTS.gain_of_restart) * before:
        return _Origin(last)
    return _Origin(last if last.value > before else restarted_from.at, restarted_from.without_gain + 1)


def _is_good(best: ScoredPoint, checkpoints: int) -> bool:
    return -best.value < CONSTANTS.good_loss * checkpoints


def _restarts(best: ScoredPoint, origin: _Origin, checkpoints: int) -> bool:
    """Return whether the next descent begins at restarts from the origin, and not at samples."""
    if _is_good(best, checkpoints):
        return True
    close = -origin.at.value < CONSTANTS.close_loss * checkpoints
    patience = CONSTANTS.patience if close else 1
    return -best.value < CONSTANTS.fair_loss * checkpoints and origin.without_gain < patience


def _race(tried: _Tried, draw: _Draw, origin: ScoredPoint, checkpoints: int) -> _Part[list[ScoredPoint]]:
    """Return the best of a batch of restarts; where the best is good, others race against it."""
    wide = _is_good(tried.best, checkpoints)
    found = yield from tried.evaluate(draw.restarts(origin.point, wide=wide))
    leader = _highest(found)
    for _ in range(CONSTANTS.races):
        if not _is_good(tried.best, checkpoints):
            break
        restarts = draw.restarts(origin.point, wide=True)
        found = yield from tried.evaluate(restarts, [leader.value] * len(restarts))
        leader = _highest([leader, *found])
    return [leader]


def _descend(
    tried: _Tried, draw: _Draw, samples: list[ScoredPoint], origin: ScoredPoint | None
) -> _Part[ScoredPoint]:
    """Descend from the best of the samples; return where the descent ends.

    ``origin`` is that of a restart, which the descent must overtake; without one it is the best of all.
    """
    size, checkpoints = samples[0].shape
    problem = LeastSquares(size, checkpoints, CONSTANTS.step_dampings)
    descent = Descent(samples[0], origin is None, problem, CONSTANTS.first_damping, [])
    scores = [descent.score(sample) for sample in samples]
    descent.at, descent.scores = samples[scores.index(max(scores))], [max(scores)]
    while True:
        for probe in (yield from tried.evaluate(draw.probes(descent.at.point))):
            descent.measure(probe)
        while True:
            batch = descent.targets()
            draw.move(batch[-1], tried.count // len(batch) % size)
            to_beat = [descent.to_beat] * (len(batch) - 1)
            *steps, probe = yield from tried.evaluate(batch, [*to_beat, -math.inf])
            descent.measure(probe)
            rival = tried.best if origin is None else origin
            if not (descent.take(steps) and descent.overtakes(rival.value)):
                break
        if not descent.may_revive():
            return descent.at
        found = yield from tried.evaluate(descent.revival_probes())
        if not descent.revive_dead_parameters(found):
            return descent.at
