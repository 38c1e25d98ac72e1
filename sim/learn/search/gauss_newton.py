"""Damped Gauss-Newton descents on the misses of every checkpoint, from many starts.

A return is one number; the misses it is made of are three for each checkpoint, and tell a search which way
each of them goes. So: draw samples around the untuned start, take the best, measure how every parameter moves
the misses (finite differences), and descend by damped Gauss-Newton steps. From then on every batch is two
steps, a bold and a careful one, and the finite difference of one parameter, drawn at random; what a step
taught corrects the other slopes (Broyden). Damping follows success and failure (Levenberg, Marquardt).

Two things get it past the local optima of a course:
  * Far from the goal it does not climb the return but how far the rover gets before it goes astray
    (``survival``): misses behind a lost turn say nothing about what comes before it, and pull the wrong way.
  * A descent that gains little over a window of steps ends, and so does one that gains too slowly to overtake
    the best. The next one starts from new samples, or, once the best is close, from hops: the best point with
    some parameters moved far. In between they take turns.

Rules of this file
  * A search knows points of the unit box; neither circuit nor simulator nor clock.
  * All candidates count, those that measure slopes too. They go out in batches, a batch in any portions, and
    only a whole batch decides anything. ``state`` may be taken within a batch.
  * A step whose return is lost may be stopped there: nothing behind that checkpoint is looked at, and all
    decisions are those of whole episodes.
  * All arithmetic is in a fixed order: the same bits on every machine.

Constants were tuned on seeds that no reported figure uses: ``docs/search.md``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sim.learn.search import least_squares
from sim.learn.search.base import SearchState, Vector
from sim.learn.search.least_squares import correct_slopes, lost_at
from sim.learn.search.packed import pack, unpack
from sim.learn.search.unit_box import UnitBox, reflected

__all__ = ["GaussNewton"]

SAMPLES = 50
SPREAD = 0.1
"""Samples of a start, and their standard deviation."""
HOPS = 10
HOP_SHARE = 0.1
HOP_SPREAD = 0.2
"""Samples of a hop, the share of parameters that one moves, and how far."""
PROBE = 3e-3
"""Step of a finite difference."""
BOLDNESS = np.array([0.2, 10.0])
"""Dampings of a batch's steps, in terms of the damping that worked last."""
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.1, 1e-7, 1e4
AFTER_FAILURE = 10.0
LIFETIME_M2 = 5.0
"""Loss that makes a checkpoint count 1/e in ``survival``."""
CLOSE_M2 = 0.3 / 22
"""Loss per checkpoint below which the return itself is climbed, and all starts are hops."""
FAIR_M2 = 1.0 / 22
"""Loss per checkpoint below which every second start is a hop, and a descent that stalls goes on with the
return itself."""
WINDOW = 80
LEAST_GAIN = 0.01
"""A descent ends when so many steps took less than this share off what is left to gain."""
OVERTAKING_WINDOW, OVERTAKING_WINDOWS = 30, 4.0
"""And when, at the pace of so many steps, so many times as many would not bring it up to the best."""


class _Phase(StrEnum):
    START = "start"
    SAMPLES = "samples"
    HOPS = "hops"
    SLOPES = "slopes"
    STEPS = "steps"


@dataclass(frozen=True)
class _Outcome:
    """A point (D,), its return, and its misses (E, C, 3)."""

    point: Vector
    value: float
    misses: Vector


def stopped(outcome: _Outcome, to_beat: float) -> _Outcome:
    """Return an outcome as it is when its episode is stopped as soon as it is lost."""
    known, total = lost_at(outcome.misses, to_beat)
    if known == outcome.misses.shape[1]:
        return outcome
    misses = outcome.misses.copy()
    misses[:, known:] = 0.0
    return _Outcome(outcome.point, total, misses)


@dataclass
class _Descent:
    at: _Outcome
    survives: bool
    """Whether ``survival`` is climbed, not the return."""
    hopped: bool
    """Whether it began at a hop, not at a sample."""
    slopes: Vector
    """(D, R) of all misses."""
    damping: float
    scores: list[float]
    """After the last steps, WINDOW + 1 at most."""

    def score(self, outcome: _Outcome) -> float:
        """Return what is climbed."""
        return float(least_squares.survival(outcome.misses, LIFETIME_M2)) if self.survives else outcome.value

    def measure(self, probe: _Outcome) -> None:
        """Take the slopes of the one parameter in which a probe differs."""
        moved = probe.point - self.at.point
        parameter = int(np.argmax(np.abs(moved)))
        self.slopes[parameter] = (probe.misses - self.at.misses).ravel() / moved[parameter]

    @property
    def to_beat(self) -> float:
        """What a step's return must exceed, at each checkpoint; minus infinity where none is ever lost."""
        episodes, _, _ = self.at.misses.shape
        return -math.inf if self.survives or episodes > 1 else self.at.value

    def learn(self, step: _Outcome) -> None:
        """Correct the slopes by what came of a step, as far as it got."""
        known, _ = lost_at(step.misses, self.to_beat)
        change = (step.misses - self.at.misses)[:, :known].ravel()
        correct_slopes(self.slopes, step.point - self.at.point, change)

    def overtakes(self, best: float) -> bool:
        """Return whether a climb of the return is above ``best``, or will be there in time."""
        gap = best - self.at.value
        if self.survives or gap <= 0.0 or len(self.scores) <= OVERTAKING_WINDOW + 1:
            return True
        gain = self.scores[-1] - self.scores[-1 - OVERTAKING_WINDOW]
        return gain * OVERTAKING_WINDOWS >= gap

    def targets(self) -> Vector:
        """Return where the steps of a batch lead, (n, D)."""
        slopes, residuals = self.slopes, self.at.misses.ravel()
        if self.survives:
            weights = np.empty_like(self.at.misses)
            least_squares.survival_weights(self.at.misses, LIFETIME_M2, weights)
            slopes, residuals = slopes * weights.ravel(), residuals * weights.ravel()
        targets = np.empty((len(BOLDNESS), len(slopes)))
        least_squares.damped_steps(slopes, residuals, self.at.point, self.damping * BOLDNESS, targets)
        return targets

    def climb_return(self) -> None:
        """Climb the return from now on."""
        self.survives = False
        self.scores = [self.at.value]

    def take(self, steps: Sequence[_Outcome]) -> bool:
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
        _, checkpoints, _ = self.at.misses.shape
        loss = -self.at.value / checkpoints
        if self.survives and loss < CLOSE_M2:
            self.climb_return()
        if len(self.scores) <= WINDOW:
            return True
        left = checkpoints - self.scores[-1] if self.survives else -self.scores[-1]
        if self.scores[-1] - self.scores[0] >= LEAST_GAIN * left:
            return True
        if self.survives and loss < FAIR_M2:
            self.climb_return()
            return True
        return False


class GaussNewton:
    """A search that maximises a return made of misses: minus the sum of their squares.

    With E episodes to a return (several courses, or trials), it is the mean over them.
    """

    needs_misses: ClassVar[bool] = True
    most_ahead: ClassVar[int] = 1000  # a batch is less
    speculates: ClassVar[bool] = False

    def __init__(self, box: UnitBox, generator: np.random.Generator) -> None:
        self._box = box
        self._generator = generator
        self.value: float | None = None
        self.evaluations = 0
        self._best = box.start
        self._phase = _Phase.START
        self._batch = self._best[None].copy()
        self._told: list[_Outcome] = []
        self._asked = 0
        self._descent: _Descent | None = None

    @property
    def incumbent(self) -> Vector:
        """The best vector (P,) so far; the untuned start before there is any."""
        vector: Vector = self._box.vectors(self._best[None])[0]
        return vector

    @property
    def iterations(self) -> int:
        """Returns taken after that of the start."""
        return max(self.evaluations - 1, 0)

    @property
    def to_beat(self) -> Vector:
        """(n,) what steps must exceed; minus infinity for what is wanted whole, to measure or compare."""
        first = len(self._told)
        return np.array([self._to_beat(number) for number in range(first, first + self._asked)])

    def _to_beat(self, number: int) -> float:
        """Return what a candidate of the batch must exceed."""
        is_step = self._phase is _Phase.STEPS and number < len(BOLDNESS)
        return self._descent.to_beat if self._descent is not None and is_step else -math.inf

    def ask(self, count: int = 1) -> Vector:
        """Return the next candidates (n, P), 1 <= n <= count, at most what is left of the batch."""
        if self._asked:
            raise RuntimeError("ask() again before tell()")
        if count < 1:
            raise ValueError(f"at least one candidate must be asked for, got {count}")
        points = self._batch[len(self._told) :][:count]
        self._asked = len(points)
        return self._box.vectors(points)

    def tell(self, values: Sequence[float] | Vector, misses: Vector | None = None) -> int:
        """Take the returns (n,) and misses (n, E, C, 3) of what ``ask`` gave; return n, as all count."""
        if misses is None:
            raise ValueError("this search needs the misses")
        if not len(values) == len(misses) == self._asked:
            raise ValueError(f"{self._asked} candidates wait for their returns, got {len(values)}")
        numbers = [float(value) for value in values]
        if any(map(math.isnan, numbers)):
            raise ValueError("a return is not a number")
        for value, row in zip(numbers, np.array(misses), strict=True):
            number = len(self._told)
            outcome = stopped(_Outcome(self._batch[number], value, row), self._to_beat(number))
            self._told.append(outcome)
            self.evaluations += 1
            if self.value is None or outcome.value > self.value:
                self.value, self._best = outcome.value, outcome.point
        told, self._asked = self._asked, 0
        if len(self._told) == len(self._batch):
            outcomes, self._told = self._told, []
            self._decide(outcomes)
        return told

    def _decide(self, outcomes: list[_Outcome]) -> None:
        """Take in a batch and draw the next one."""
        if self._descent is None:
            if self._phase is _Phase.START:
                self._draw_samples(outcomes[0])
            else:
                self._descend(outcomes)
            return
        if self._phase is _Phase.SLOPES:
            goes_on = True
            for probe in outcomes:
                self._descent.measure(probe)
        else:
            *steps, probe = outcomes
            self._descent.measure(probe)
            assert self.value is not None
            goes_on = self._descent.take(steps) and self._descent.overtakes(self.value)
        if goes_on:
            self._phase = _Phase.STEPS
            parameters = self._generator.integers(0, self._box.size, 1)
            self._batch = np.concatenate([self._descent.targets(), self._probes(parameters)])
        else:
            self._draw_samples(self._descent.at)

    def _draw_samples(self, last: _Outcome) -> None:
        """Draw the samples from which the next descent will start."""
        hopped = self._descent is not None and self._descent.hopped
        self._descent = None
        assert self.value is not None
        if -self.value / last.misses.shape[1] < (CLOSE_M2 if hopped else FAIR_M2):
            self._phase = _Phase.HOPS
            moved = self._generator.random((HOPS, self._box.size)) < HOP_SHARE
            moves = HOP_SPREAD * self._generator.standard_normal(moved.shape)
            self._batch = reflected(self._best + np.where(moved, moves, 0.0))
        else:
            self._phase = _Phase.SAMPLES
            moves = SPREAD * self._generator.standard_normal((SAMPLES, self._box.size))
            self._batch = reflected(self._box.start + moves)

    def _descend(self, samples: list[_Outcome]) -> None:
        """Begin a descent from the best sample: measure all slopes there."""
        hopped = self._phase is _Phase.HOPS
        slopes = np.zeros((self._box.size, samples[0].misses.size))
        self._descent = descent = _Descent(samples[0], not hopped, hopped, slopes, FIRST_DAMPING, [])
        scores = [descent.score(sample) for sample in samples]
        best = max(range(len(samples)), key=scores.__getitem__)
        descent.at, descent.scores = samples[best], [scores[best]]
        self._phase = _Phase.SLOPES
        self._batch = self._probes(np.arange(self._box.size))

    def _probes(self, parameters: NDArray[np.int64]) -> Vector:
        """Return the descent's point with one parameter moved, up or down, within the box: (n, D)."""
        assert self._descent is not None
        point = self._descent.at.point
        probes = np.empty((len(parameters), len(point)))
        probes[:] = point
        ways = self._generator.random(len(parameters)) < 0.5
        for probe, parameter, up in zip(probes, parameters.tolist(), ways.tolist(), strict=True):
            there = probe[parameter] + (PROBE if up else -PROBE)
            if there > 1.0:
                there = probe[parameter] - PROBE
            elif there < 0.0:
                there = probe[parameter] + PROBE
            probe[parameter] = there
        return probes

    def state(self) -> SearchState:
        """Return all that the next ``ask`` depends on; only between ``tell`` and ``ask``."""
        if self._asked:
            raise RuntimeError("state() between ask() and tell()")
        descent = self._descent
        return {
            "evaluations": self.evaluations,
            "value": self.value,
            "incumbent": self.incumbent.tolist(),
            "best": pack(self._best),
            "generator": self._generator.bit_generator.state,
            "phase": str(self._phase),
            "batch": pack(self._batch),
            "values": [outcome.value for outcome in self._told],
            "misses": pack(np.array([outcome.misses for outcome in self._told])),
            "descent": descent
            and {
                "point": pack(descent.at.point),
                "value": descent.at.value,
                "misses": pack(descent.at.misses),
                "survives": descent.survives,
                "hopped": descent.hopped,
                "slopes": pack(descent.slopes),
                "damping": descent.damping,
                "scores": list(descent.scores),
            },
        }

    def restore(self, state: SearchState) -> None:
        """Continue from a ``state()``. Raises ValueError, KeyError or TypeError if it is not one of ours."""
        value, evaluations = state["value"], int(state["evaluations"])
        if (value is None) != (evaluations == 0) or (value is not None and not math.isfinite(value)):
            raise ValueError(f"a return of {value} after {evaluations} evaluations cannot be")
        best = unpack(state["best"], (self._box.size,))
        if self._box.vectors(best[None])[0].tolist() != list(state["incumbent"]):
            raise ValueError("the best point is not the incumbent")
        phase = _Phase(state["phase"])
        sizes = {
            _Phase.START: 1,
            _Phase.SAMPLES: SAMPLES,
            _Phase.HOPS: HOPS,
            _Phase.SLOPES: self._box.size,
            _Phase.STEPS: len(BOLDNESS) + 1,
        }
        batch = unpack(state["batch"], (sizes[phase], self._box.size))
        values = [float(told) for told in state["values"]]
        misses = unpack(state["misses"], (None, None, None, 3) if values else (0,))
        if len(misses) != len(values) or len(values) >= len(batch):
            raise ValueError(f"{len(values)} of a batch of {len(batch)} cannot have been told")
        descent = self._restored_descent(state["descent"])
        if (descent is None) == (phase in (_Phase.SLOPES, _Phase.STEPS)):
            raise ValueError(f"a descent does not go with the phase {phase}")
        self._generator.bit_generator.state = state["generator"]
        self.value, self.evaluations, self._best = value, evaluations, best
        self._phase, self._batch, self._descent, self._asked = phase, batch, descent, 0
        self._told = [_Outcome(*told) for told in zip(batch, values, misses, strict=False)]

    def _restored_descent(self, state: Mapping[str, Any] | None) -> _Descent | None:
        if state is None:
            return None
        point, misses = unpack(state["point"], (self._box.size,)), unpack(state["misses"], (None, None, 3))
        descent = _Descent(
            at=_Outcome(point, float(state["value"]), misses),
            survives=bool(state["survives"]),
            hopped=bool(state["hopped"]),
            slopes=unpack(state["slopes"], (self._box.size, misses.size)),
            damping=float(state["damping"]),
            scores=[float(score) for score in state["scores"]],
        )
        if not 1 <= len(descent.scores) <= WINDOW + 1 or not 0.0 < descent.damping <= MOST_DAMPING:
            raise ValueError("a descent of such scores or damping cannot be")
        return descent
