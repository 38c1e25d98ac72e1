"""One descent: damped Gauss-Newton steps on the residuals, and the revival of dead parameters.

A step minimises what the slopes predict (``damped_steps``); its outcome corrects them. Far from the goal a
descent climbs how far the rover gets before it goes astray (``survival``), close to it the return.

Most descents that end in the deepest local optimum of a course (turn once, never back) have lost a motor
neuron on the way: at first less of it is better, then it stays below the potential at which its motor begins
to act, and its parameters have no slope any more. A descent that stalls therefore looks for dead parameters,
moves each of them far, alone, and continues from where one has an effect again.

This module evaluates nothing; ``gauss_newton`` does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.learn.search.least_squares import LeastSquares, ScoredPoint
from sim.learn.search.unit_box import Vector

_CHECKPOINTS = 22
"""Of the parking course, by whose returns the limits were found."""


@dataclass(frozen=True)
class GaussNewtonConstants:
    """Constants of the Gauss-Newton search, tuned on seeds that no reported figure uses (``docs/search.md``).

    Points are in the unit box, so that shares and deviations are fractions of each parameter's range. A loss
    is minus the return. Limits of a loss are per checkpoint, in m² (1 rad counts as 1 m).
    """

    # -- where descents start --
    samples: int = 50
    """Candidates around the untuned parameters, of which the best starts a descent."""
    sample_spread: float = 0.1
    """Standard deviation of the samples."""
    restarts: int = 10
    """Candidates of a restart: copies of the origin with some parameters moved."""
    restart_share: float = 0.1
    """Share of the parameters that a candidate of a restart moves."""
    wide_restart_share: float = 0.2
    """The same where the best is good."""
    restart_spread: float = 0.2
    """Standard deviation of a moved parameter."""
    races: int = 60
    """Further batches of candidates where the best is good; they race against the best before them."""
    good_loss: float = 0.07 / _CHECKPOINTS
    """Loss of the best below which every descent is a restart from it."""
    fair_loss: float = 1.0 / _CHECKPOINTS
    """Loss of the best above which every descent starts from samples."""
    patience: int = 4
    """Restarts without gain, from an origin that is close, after which samples are drawn; otherwise one."""
    gain_of_restart: float = 0.1
    """Share of the origin's loss that a restart must take off to count as a gain."""
    near_best: float = 3.0
    """Restarts begin where a descent from samples ended if its loss is less than the best's times this."""

    # -- steps --
    probe: float = 3e-3
    """Step of a finite difference."""
    step_dampings: tuple[float, ...] = (0.2, 10.0)
    """Dampings of a batch's steps as factors of the damping that worked last; far from the goal the first."""
    first_damping: float = 0.1
    min_damping: float = 1e-7
    max_damping: float = 1e4
    damping_after_failure: float = 10.0
    """Factor of the damping when no step of a batch gained."""

    # -- what is climbed, and until when --
    lifetime: float = 5.0
    """Loss (m², summed) after which a checkpoint counts 1/e in the survival."""
    close_loss: float = 0.3 / _CHECKPOINTS
    """Loss below which the return itself is climbed."""
    stalled_loss: float = 2.0 / _CHECKPOINTS
    """Loss below which a stalled climb of the survival continues with the return."""
    near_loss: float = 0.1 / _CHECKPOINTS
    """Loss below which a climb of the return may be slow."""
    window: int = 80
    """Steps over which the gain of a descent is measured."""
    min_gain: float = 0.01
    """Share of what is left to gain that a window must gain."""
    min_gain_of_return: float = 0.05
    """The same for a return that is not near: at ``min_gain`` a crawl takes half an agent's candidates."""
    overtaking_window: int = 30
    overtaking_windows: float = 4.0
    """A climb of the return ends if, at the pace of the last ``overtaking_window`` steps, so many times as
    many would not reach the best."""

    # -- dead parameters --
    dead_effect: float = 0.01
    """Change of a residual (m, rad) that counts as none."""
    revival_moves: tuple[float, ...] = (0.05, 0.15, 0.4)
    """How far dead parameters are moved, up and down."""
    max_dead: int = 16
    """The most parameters that are moved: those with the smallest slopes."""
    revival_price: float = 0.1
    """Share of the checkpoints not yet survived that may be lost for an effect."""
    revivals: int = 2
    """How often a descent looks for dead parameters."""


CONSTANTS = GaussNewtonConstants()


@dataclass
class Descent:
    """A climb from point to point, with its history."""

    at: ScoredPoint
    survives: bool
    """Whether ``survival`` is climbed, not the return."""
    problem: LeastSquares
    damping: float
    scores: list[float]
    """After the last steps, at most the window and one."""
    revivals: int = 0
    """How often dead parameters were looked for."""

    @property
    def to_beat(self) -> float:
        """What a step's return must exceed, at each checkpoint; minus infinity if they always count."""
        return -math.inf if self.survives else self.at.value

    def score(self, outcome: ScoredPoint) -> float:
        """Return what is climbed."""
        return self.problem.survival(outcome, CONSTANTS.lifetime) if self.survives else outcome.value

    def targets(self) -> Vector:
        """Return where the n steps of a batch lead, and the point that they start from: (n + 1, D)."""
        if self.survives:
            return self.problem.steps(self.at, self.damping, 1, CONSTANTS.lifetime)
        return self.problem.steps(self.at, self.damping, len(CONSTANTS.step_dampings))

    def measure(self, probe: ScoredPoint) -> None:
        """Take the slopes of the one parameter in which a probe differs."""
        self.problem.measure(self.at, probe)

    def take(self, steps: Sequence[ScoredPoint]) -> bool:
        """Move to the best step if it is higher; return whether the descent continues."""
        scores = [self.score(step) for step in steps]
        best = scores.index(max(scores))
        if scores[best] > self.scores[-1]:
            self.problem.correct(self.at, steps[best], self.to_beat)
            self.at = steps[best]
            damping = self.damping * CONSTANTS.step_dampings[best]
            self.scores.append(scores[best])
        else:
            # The careful one: there the slopes are most nearly right.
            self.problem.correct(self.at, steps[-1], self.to_beat)
            damping = self.damping * CONSTANTS.damping_after_failure
            self.scores.append(self.scores[-1])
        self.damping = min(max(damping, CONSTANTS.min_damping), CONSTANTS.max_damping)
        del self.scores[: -CONSTANTS.window - 1]
        return self._continues()

    def _continues(self) -> bool:
        """Return whether recent steps gained enough; a climb of the survival may become one of the return."""
        checkpoints = len(self.at.residuals)
        loss = -self.at.value / checkpoints
        if self.survives and loss < CONSTANTS.close_loss:
            self._climb_return()
        if len(self.scores) <= CONSTANTS.window:
            return True
        left = checkpoints - self.scores[-1] if self.survives else -self.scores[-1]
        slow = self.survives or loss < CONSTANTS.near_loss
        least = CONSTANTS.min_gain if slow else CONSTANTS.min_gain_of_return
        if self.scores[-1] - self.scores[0] >= least * left:
            return True
        if self.survives and loss < CONSTANTS.stalled_loss:
            self._climb_return()
            return True
        return False

    def _climb_return(self) -> None:
        self.survives = False
        self.scores = [self.at.value]

    def overtakes(self, best: float) -> bool:
        """Return whether a climb of the return is above ``best``, or will be there in time."""
        gap, window = best - self.at.value, CONSTANTS.overtaking_window
        if self.survives or gap <= 0.0 or len(self.scores) <= window + 1:
            return True
        gain = self.scores[-1] - self.scores[-1 - window]
        return gain * CONSTANTS.overtaking_windows >= gap

    def may_revive(self) -> bool:
        """Return whether a descent that ended should look for dead parameters."""
        return self.survives and self.revivals < CONSTANTS.revivals and len(self._dead()) > 0

    def _dead(self) -> NDArray[np.int64]:
        """Return the parameters that, by their slopes, change no residual by much anywhere in their range."""
        effects = np.abs(self.problem.slopes).max(axis=1)
        dead: NDArray[np.int64] = effects.argsort(kind="stable")[: (effects < CONSTANTS.dead_effect).sum()]
        return dead[: CONSTANTS.max_dead]

    def revival_probes(self) -> Vector:
        """Return the point with each dead parameter moved far, alone: (n, D)."""
        probes = []
        for parameter in self._dead().tolist():
            for move in CONSTANTS.revival_moves:
                for there in (self.at.point[parameter] - move, self.at.point[parameter] + move):
                    if 0.0 <= there <= 1.0:
                        probes.append(self.at.point.copy())
                        probes[-1][parameter] = there
        return np.array(probes)

    def revive_dead_parameters(self, probes: Sequence[ScoredPoint]) -> bool:
        """Move to the probe with the most effect at a fair price, if any; then measure all slopes again."""
        self.revivals += 1
        price = CONSTANTS.revival_price * (len(self.at.residuals) - self.scores[-1])
        effects = [float(np.abs(probe.residuals - self.at.residuals).max()) for probe in probes]
        alive = [
            number
            for number, probe in enumerate(probes)
            if effects[number] > CONSTANTS.dead_effect and self.score(probe) >= self.scores[-1] - price
        ]
        if not alive:
            return False
        self.at = probes[max(alive, key=effects.__getitem__)]
        self.scores = [self.score(self.at)]
        self.damping = CONSTANTS.first_damping
        return True
