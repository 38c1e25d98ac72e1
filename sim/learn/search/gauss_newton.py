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

All candidates count as iterations, those that measure slopes too. They are handed out in portions of a
batch, and a decision needs the whole batch. No decision depends on the residuals of a truncated candidate
behind the checkpoint where it was truncated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat, TypeAdapter

from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.base import SearchState, Strategy, Vector
from sim.learn.search.constants import CONSTANTS
from sim.learn.search.descent import Array, Descent, Outcome
from sim.learn.search.unit_box import UnitBox, reflected


class _Phase(StrEnum):
    """What the candidates of a batch are."""

    START = "start"
    SAMPLES = "samples"
    RESTARTS = "restarts"
    SLOPES = "slopes"
    STEPS = "steps"
    REVIVAL = "revival"


@dataclass
class _Origin:
    """Where restarts begin."""

    point: Array
    value: FiniteFloat
    without_gain: int = 0
    """Restarts since the last gain."""


@dataclass
class _Race:
    """Candidates of a restart, compared batch by batch."""

    best: Outcome
    batches: int = 0
    """Batches that raced."""


@dataclass
class _Progress:
    """All that the next ``ask`` depends on but the random generator."""

    best: Array
    """(D,)."""
    batch: Array
    """(n, D) candidates."""
    phase: _Phase = _Phase.START
    value: FiniteFloat | None = None
    evaluations: int = 0
    values: list[float] = field(default_factory=list)
    """Returns of the first candidates of the batch."""
    residuals: list[Array] = field(default_factory=list)
    """(C, 3) each."""
    descent: Descent | None = None
    origin: _Origin | None = None
    race: _Race | None = None


_PROGRESS = TypeAdapter(_Progress)


class GaussNewton:
    """A search that maximises a return made of residuals: minus the sum of their squares."""

    max_ahead: ClassVar[int] = 1000  # a batch is less
    speculates: ClassVar[bool] = False

    def __init__(self, box: UnitBox, generator: np.random.Generator) -> None:
        self._box = box
        self._generator = generator
        self._asked = 0
        self._progress = _Progress(box.start, box.start[None])

    @classmethod
    def begin(
        cls,
        layout: ParameterLayout,
        defaults: Vector,
        generator: np.random.Generator,
        inert: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Begin at the defaults (P,)."""
        return cls(UnitBox.of(layout, defaults, inert), generator)

    @property
    def incumbent(self) -> Vector:
        """The best vector (P,) so far; the untuned start before there is any."""
        vector: Vector = self._box.vectors(self._progress.best[None])[0]
        return vector

    @property
    def value(self) -> float | None:
        """The incumbent's return."""
        return self._progress.value

    @property
    def evaluations(self) -> int:
        """Returns taken."""
        return self._progress.evaluations

    @property
    def iterations(self) -> int:
        """Returns taken after that of the start."""
        return max(self._progress.evaluations - 1, 0)

    @property
    def to_beat(self) -> Vector:
        """(n,) what steps and racing candidates must exceed; minus infinity for what is wanted whole."""
        now, least = self._progress, -math.inf
        if now.race is not None:
            least = now.race.best.value
        elif now.phase is _Phase.STEPS and now.descent is not None:
            least = now.descent.to_beat
        to_beat = [least] * self._asked
        if now.phase is _Phase.STEPS and len(now.values) + self._asked == len(now.batch):
            to_beat[-1] = -math.inf  # the probe
        return np.array(to_beat)

    def ask(self, count: int = 1) -> Vector:
        """Return the next candidates (n, P), 1 <= n <= count, at most what is left of the batch."""
        if self._asked:
            raise RuntimeError("ask() again before tell()")
        if count < 1:
            raise ValueError(f"at least one candidate must be asked for, got {count}")
        points = self._progress.batch[len(self._progress.values) :][:count]
        self._asked = len(points)
        return self._box.vectors(points)

    def tell(self, values: Sequence[float] | Vector, residuals: Vector | None = None) -> int:
        """Take the returns (n,) and residuals (n, 1, C, 3) of what ``ask`` gave; return n, as all count."""
        if residuals is None:
            raise ValueError("this search needs the residuals")
        if not len(values) == len(residuals) == self._asked:
            raise ValueError(f"{self._asked} candidates wait for their returns, got {len(values)}")
        numbers = np.asarray(values, np.float64).tolist()
        if math.isnan(sum(numbers)):
            raise ValueError("a return is not a number")
        now = self._progress
        highest = max(numbers)
        if now.value is None or highest > now.value:
            now.value = highest
            now.best = now.batch[len(now.values) + numbers.index(highest)]
        now.values += numbers
        # A copy, because an evaluator may use its array again.
        now.residuals.extend(residuals.reshape(len(numbers), -1, 3).copy())
        now.evaluations += len(numbers)
        asked, self._asked = self._asked, 0
        if len(now.values) == len(now.batch):
            outcomes = list(map(Outcome, now.batch, now.values, now.residuals))
            now.values, now.residuals = [], []
            self._decide(outcomes)
        return asked

    def _decide(self, outcomes: list[Outcome]) -> None:
        """Take in a batch and draw the next one."""
        now = self._progress
        if now.phase is _Phase.START:
            self._start_again(outcomes[0])
        elif now.phase is _Phase.SAMPLES:
            self._descend(outcomes)
        elif now.phase is _Phase.RESTARTS:
            self._race(max(outcomes, key=lambda outcome: outcome.value))
        elif now.descent is None:
            raise AssertionError(f"no descent in the phase {now.phase}")
        elif now.phase is _Phase.SLOPES:
            for probe in outcomes:
                now.descent.measure(probe)
            self._step(now.descent)
        elif now.phase is _Phase.STEPS:
            self._take(now.descent, outcomes[:-1], outcomes[-1])
        elif now.descent.revive_dead_parameters(outcomes):
            self._measure_slopes(now.descent)
        else:
            self._start_again(now.descent.at)

    def _take(self, descent: Descent, steps: list[Outcome], probe: Outcome) -> None:
        now = self._progress
        descent.measure(probe)
        to_overtake = now.origin.value if descent.restarted and now.origin else self._best_value
        if descent.take(steps) and descent.overtakes(to_overtake):
            self._step(descent)
        elif descent.may_revive():
            now.phase, now.batch = _Phase.REVIVAL, descent.revival_probes()
        else:
            self._start_again(descent.at)

    @property
    def _best_value(self) -> float:
        assert self._progress.value is not None
        return self._progress.value

    # -- the next batch --

    def _start_again(self, last: Outcome) -> None:
        """Draw the candidates from which the next descent starts, ``last`` being where one ended."""
        now = self._progress
        restarts = self._restarts_after(last, now.descent is not None and now.descent.restarted)
        now.descent = None
        if restarts:
            now.phase = _Phase.RESTARTS
            self._draw_restarts(wide=self._best_is_good(len(last.residuals)))
        else:
            now.phase = _Phase.SAMPLES
            moves = self._generator.standard_normal((CONSTANTS.samples, self._box.size))
            now.batch = reflected(self._box.start + CONSTANTS.sample_spread * moves)

    def _restarts_after(self, last: Outcome, restarted: bool) -> bool:
        """Choose the origin of restarts; return whether the next descent is one, and not from samples."""
        now, checkpoints = self._progress, len(last.residuals)
        best = _Origin(now.best, self._best_value)
        ended = _Origin(last.point, last.value)
        if not restarted or now.origin is None:
            now.origin = best if last.value < CONSTANTS.near_best * best.value else ended
        elif last.value > (1.0 - CONSTANTS.gain_of_restart) * now.origin.value:
            now.origin = ended
        else:
            ended.without_gain = now.origin.without_gain = now.origin.without_gain + 1
            if last.value > now.origin.value:
                now.origin = ended
        if self._best_is_good(checkpoints):
            now.origin = best
            return True
        close = -now.origin.value < CONSTANTS.close_loss * checkpoints
        patience = CONSTANTS.patience if close else 1
        return -best.value < CONSTANTS.fair_loss * checkpoints and now.origin.without_gain < patience

    def _best_is_good(self, checkpoints: int) -> bool:
        return -self._best_value < CONSTANTS.good_loss * checkpoints

    def _draw_restarts(self, wide: bool) -> None:
        now = self._progress
        assert now.origin is not None
        share = CONSTANTS.wide_restart_share if wide else CONSTANTS.restart_share
        moved = self._generator.random((CONSTANTS.restarts, self._box.size)) < share
        moves = CONSTANTS.restart_spread * self._generator.standard_normal(moved.shape)
        now.batch = reflected(now.origin.point + np.where(moved, moves, 0.0))

    def _race(self, candidate: Outcome) -> None:
        """Take in the best of a batch of restarts; draw others to race against it, or descend from it."""
        now = self._progress
        if now.race is None:
            now.race = _Race(candidate)
        else:
            now.race.batches += 1
            if candidate.value > now.race.best.value:
                now.race.best = candidate
        if now.race.batches < CONSTANTS.races and self._best_is_good(len(candidate.residuals)):
            self._draw_restarts(wide=True)
        else:
            best, now.race = now.race.best, None
            self._descend([best])

    def _descend(self, samples: list[Outcome]) -> None:
        """Begin a descent from the best sample."""
        now = self._progress
        restarted = now.phase is _Phase.RESTARTS
        slopes = np.zeros((self._box.size, samples[0].residuals.size))
        now.descent = Descent(samples[0], not restarted, restarted, slopes, CONSTANTS.first_damping, [])
        scores = [now.descent.score(sample) for sample in samples]
        now.descent.at, now.descent.scores = samples[scores.index(max(scores))], [max(scores)]
        self._measure_slopes(now.descent)

    def _measure_slopes(self, descent: Descent) -> None:
        self._progress.phase = _Phase.SLOPES
        self._progress.batch = np.tile(descent.at.point, (self._box.size, 1))
        for parameter, probe in enumerate(self._progress.batch):
            self._move(probe, parameter)

    def _step(self, descent: Descent) -> None:
        batch = descent.targets()
        self._move(batch[-1], self.evaluations // len(batch) % self._box.size)
        self._progress.phase, self._progress.batch = _Phase.STEPS, batch

    def _move(self, probe: Vector, parameter: int) -> None:
        """Move one parameter of a point (D,), up or down, within the box."""
        here = float(probe[parameter])
        there = here + (CONSTANTS.probe if self._generator.random() < 0.5 else -CONSTANTS.probe)
        probe[parameter] = there if 0.0 <= there <= 1.0 else 2.0 * here - there

    # -- its state --

    def state(self) -> SearchState:
        """Return all that the next ``ask`` depends on; only between ``tell`` and ``ask``."""
        if self._asked:
            raise RuntimeError("state() between ask() and tell()")
        return {
            "incumbent": self.incumbent.tolist(),
            "generator": self._generator.bit_generator.state,
            **_PROGRESS.dump_python(self._progress),
            "phase": self._progress.phase.value,  # a process that only keeps states need not load this module
        }

    def restore(self, state: SearchState) -> None:
        """Continue from a ``state()``."""
        self._progress, self._asked = _PROGRESS.validate_python(state), 0
        self._generator.bit_generator.state = state["generator"]


SEARCH: type[Strategy] = GaussNewton
