"""One descent: damped Gauss-Newton steps on the misses, and how it gets over what would stop it.

A step minimises what the slopes predict (``damped_steps``); what came of it corrects them. Far from the goal
a descent climbs how far the rover gets before it goes astray (``survival``), close to it the return.

Most descents that end in the deepest local optimum of a course (turn once, never back) have lost a motor
neuron on the way: first it had better do less, then it stays below the potential at which its motor begins
to act, and no parameter of it has a slope any more. So a descent that stalls looks for parameters without
effect, moves each of them far, alone, and goes on from where one has an effect again.

Values in, values out: what is evaluated is up to ``gauss_newton``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.learn.search import least_squares
from sim.learn.search.base import Vector

BOLDNESS = np.array([0.2, 10.0])
"""Dampings of a batch's steps, in terms of the damping that worked last; only the first far from the goal."""
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.1, 1e-7, 1e4
AFTER_FAILURE = 10.0
LIFETIME_M2 = 5.0
"""Loss that makes a checkpoint count 1/e in ``survival``."""
CLOSE_M2 = 0.3 / 22
"""Loss per checkpoint below which the return itself is climbed."""
STALLED_M2 = 2.0 / 22
"""Loss per checkpoint below which a descent that stalls goes on with the return itself."""
WINDOW = 80
LEAST_GAIN, LEAST_GAIN_OF_RETURN = 0.01, 0.05
"""A descent ends when so many steps took less than this share off what is left to gain; the second where a
return is climbed that is not yet near: at the first one's pace a crawl takes half an agent's candidates."""
NEAR_M2 = 0.1 / 22
"""Loss per checkpoint below which any gain will do."""
OVERTAKING_WINDOW, OVERTAKING_WINDOWS = 30, 4.0
"""And when, at the pace of so many steps, so many times as many would not bring it up to the best."""
SILENT = 0.01
"""Change of a miss (m, rad) that is none."""
FAR = (0.05, 0.15, 0.4)
"""How far silent parameters are moved."""
FAIR_PRICE = 0.1
"""Share of the checkpoints not yet survived that may be lost for an effect."""
MOST_SILENT = 16
"""The most that are moved: those with the smallest slopes."""
MOST_WOKEN = 2
"""How often a descent looks for silent parameters."""


class Outcome(NamedTuple):
    """A point (D,), its return, and its misses (E, C, 3)."""

    point: Vector
    value: float
    misses: Vector


def stopped(outcome: Outcome, to_beat: float) -> Outcome:
    """Return an outcome as it is when its episode is stopped as soon as it is lost."""
    if to_beat == -math.inf:
        return outcome
    known, total = least_squares.lost_at(outcome.misses, to_beat)
    if known == outcome.misses.shape[1]:
        return outcome
    misses = outcome.misses.copy()
    misses[:, known:] = 0.0
    return Outcome(outcome.point, total, misses)


@dataclass
class Descent:
    """A climb from point to point, with its history."""

    at: Outcome
    survives: bool
    """Whether ``survival`` is climbed, not the return."""
    hopped: bool
    """Whether it began at a hop, not at a sample."""
    slopes: Vector
    """(D, R) of all misses."""
    damping: float
    scores: list[float]
    """After the last steps, WINDOW + 1 at most."""
    woken: int = 0
    """How often it has looked for what had fallen silent."""

    def __post_init__(self) -> None:
        """Make room for the weights (E, C, 3) of the misses."""
        self._weights = np.empty_like(self.at.misses)

    @property
    def boldness(self) -> Vector:
        """Dampings of a batch's steps, in terms of the damping that worked last."""
        return BOLDNESS[:1] if self.survives else BOLDNESS

    def score(self, outcome: Outcome) -> float:
        """Return what is climbed."""
        return float(least_squares.survival(outcome.misses, LIFETIME_M2)) if self.survives else outcome.value

    def measure(self, probe: Outcome) -> None:
        """Take the slopes of the one parameter in which a probe differs."""
        at = self.at
        least_squares.measure_slope(self.slopes, at.point, at.misses, probe.point, probe.misses)

    @property
    def to_beat(self) -> float:
        """The threshold for a step's return, at each checkpoint; minus infinity where no step is pruned."""
        episodes, _, _ = self.at.misses.shape
        return -math.inf if self.survives or episodes > 1 else self.at.value

    def learn(self, step: Outcome) -> None:
        """Correct the slopes by what came of a step, as far as it got."""
        at, to_beat, known = self.at, self.to_beat, step.misses.shape[1]
        if to_beat > -math.inf:
            known, _ = least_squares.lost_at(step.misses, to_beat)
        least_squares.correct_slopes(self.slopes, at.point, at.misses, step.point, step.misses, known)

    def overtakes(self, best: float) -> bool:
        """Return whether a climb of the return is above ``best``, or will be there in time."""
        gap = best - self.at.value
        if self.survives or gap <= 0.0 or len(self.scores) <= OVERTAKING_WINDOW + 1:
            return True
        gain = self.scores[-1] - self.scores[-1 - OVERTAKING_WINDOW]
        return gain * OVERTAKING_WINDOWS >= gap

    def write_targets(self, targets: Vector) -> None:
        """Write where the steps of a batch lead, (n, D)."""
        at, weights, dampings = self.at, self._weights, self.damping * self.boldness
        if self.survives:
            least_squares.survival_weights(at.misses, LIFETIME_M2, weights)
        else:
            weights.fill(1.0)
        least_squares.damped_steps(
            self.slopes, at.misses.ravel(), weights.ravel(), at.point, dampings, targets
        )

    def climb_return(self) -> None:
        """Climb the return from now on."""
        self.survives = False
        self.scores = [self.at.value]

    def take(self, steps: Sequence[Outcome]) -> bool:
        """Go where the best step leads if that is higher; return whether the descent goes on."""
        scores = [self.score(step) for step in steps]
        best = max(range(len(steps)), key=scores.__getitem__)
        if scores[best] > self.scores[-1]:
            self.learn(steps[best])
            self.at = steps[best]
            self.damping = min(max(self.damping * float(BOLDNESS[best]), LEAST_DAMPING), MOST_DAMPING)
            self.scores.append(scores[best])
        else:
            self.learn(steps[-1])  # the careful one: where slopes are most nearly right
            self.damping = min(self.damping * AFTER_FAILURE, MOST_DAMPING)
            self.scores.append(self.scores[-1])
        del self.scores[: -WINDOW - 1]
        return self._goes_on()

    def _goes_on(self) -> bool:
        """Return whether recent steps gained enough; a climb of the survival may become one of the return."""
        _, checkpoints, _ = self.at.misses.shape
        loss = -self.at.value / checkpoints
        if self.survives and loss < CLOSE_M2:
            self.climb_return()
        if len(self.scores) <= WINDOW:
            return True
        left = checkpoints - self.scores[-1] if self.survives else -self.scores[-1]
        least = LEAST_GAIN if self.survives or loss < NEAR_M2 else LEAST_GAIN_OF_RETURN
        if self.scores[-1] - self.scores[0] >= least * left:
            return True
        if self.survives and loss < STALLED_M2:
            self.climb_return()
            return True
        return False

    @property
    def silent(self) -> NDArray[np.int64]:
        """Parameters that would move no miss by much, anywhere in their range, if slopes are believed."""
        effects = np.abs(self.slopes).max(axis=1)
        silent: NDArray[np.int64] = np.argsort(effects, kind="stable")[: np.count_nonzero(effects < SILENT)]
        return silent[:MOST_SILENT]

    def far_probes(self) -> Vector:
        """Return the point with each silent parameter moved far, alone: (n, D), n > 0 if any is silent."""
        probes = []
        for parameter in self.silent.tolist():
            for move in FAR:
                for there in (self.at.point[parameter] - move, self.at.point[parameter] + move):
                    if 0.0 <= there <= 1.0:
                        probes.append(self.at.point.copy())
                        probes[-1][parameter] = there
        return np.array(probes).reshape(-1, len(self.at.point))

    def wake(self, probes: Sequence[Outcome]) -> bool:
        """Go where a silent parameter has the most effect at a fair price, if one has any; all slopes are
        then to be measured again."""
        self.woken += 1
        _, checkpoints, _ = self.at.misses.shape
        least = self.scores[-1] - FAIR_PRICE * (checkpoints - self.scores[-1])
        effects = [float(np.abs(probe.misses - self.at.misses).max()) for probe in probes]
        awake = [n for n, probe in enumerate(probes) if effects[n] > SILENT and self.score(probe) >= least]
        if not awake:
            return False
        self.at = probes[max(awake, key=effects.__getitem__)]
        self.scores = [self.score(self.at)]
        self.damping = FIRST_DAMPING
        return True
