"""Damped Gauss-Newton descents on the misses of every checkpoint, from many starts.

A return is one number. Its misses are three numbers for each checkpoint; they show the search the direction
of each error. So: draw samples around the untuned start, take the best, measure how every parameter moves
the misses (finite differences), and descend by damped Gauss-Newton steps. From then on every batch is a
bold step, close to the goal also a careful one, and the finite difference of one parameter, each in its turn;
what a step taught corrects the other slopes (Broyden). Damping follows success and failure (Levenberg,
Marquardt).

Three things get it past the local optima of a course:
  * Far from the goal it does not climb the return but how far the rover gets before it goes astray
    (``survival``): misses behind a lost turn say nothing about what comes before it, and pull the wrong way.
  * A descent that stalls there looks for motors that have fallen silent, and wakes them (``descent``).
  * A descent that gains little over a window of steps ends, and so does one that gains too slowly to overtake
    the best. Then come hops: the point reached, with some parameters moved far. Where hops are fruitless, the
    next descent starts from new samples, and hops go from its end if that is nearly as good as the best. So
    no agent spends its candidates on one place that leads nowhere, unless that is good. There hops are wider
    and many: all but the first few race against the best of them, which costs less than half as much as
    whole episodes do.

Rules of this file
  * A search knows points of the unit box; neither circuit nor simulator nor clock.
  * All candidates count, those that measure slopes too. They go out in batches, a batch in any portions, and
    only a whole batch decides anything. ``state`` may be taken within a batch.
  * A step or hop whose return is lost may be stopped there: nothing behind that checkpoint is looked at, and
    all decisions are those of whole episodes.
  * All arithmetic is in a fixed order: the same bits on every machine.

Constants were tuned on seeds that no reported figure uses: ``docs/search.md``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, ClassVar

import numpy as np

from sim.learn.search.base import SearchState, Vector
from sim.learn.search.descent import (
    CLOSE_M2,
    FIRST_DAMPING,
    MOST_DAMPING,
    MOST_WOKEN,
    WINDOW,
    Descent,
    Outcome,
    stopped,
)
from sim.learn.search.packed import pack, unpack
from sim.learn.search.unit_box import UnitBox, reflected

SAMPLES = 50
SPREAD = 0.1
"""Samples of a start, and their standard deviation."""
HOPS = 10
HOP_SHARE, WIDE_HOP_SHARE = 0.1, 0.2
HOP_SPREAD = 0.2
"""Samples of a hop, the share of parameters that one moves, elsewhere and where the best is good, and how
far."""
HOP_RACES = 60
"""So many times as many follow where the best is good, and race against the best of all before."""
PROBE = 3e-3
"""Step of a finite difference."""
GOOD_M2 = 0.07 / 22
"""Loss per checkpoint of the best below which all starts are hops from it."""
FAIR_M2 = 1.0 / 22
"""And above which none is."""
PATIENCE = 4
"""Fruitless hops after which new samples are drawn, where the return is climbed; elsewhere after one."""
FRUITFUL = 0.1
"""Share of the loss that a hop must take off to count."""
NEAR_BEST = 3.0
"""Loss in terms of the best's up to which hops go from where a descent from samples ended."""


class _Phase(StrEnum):
    START = "start"
    SAMPLES = "samples"
    HOPS = "hops"
    SLOPES = "slopes"
    STEPS = "steps"
    FAR = "far"


@dataclass
class _Base:
    """Start of hops."""

    point: Vector
    value: float
    fruitless: int = 0
    """Hops since the last that was worth it."""


@dataclass
class _Hops:
    """Samples around the base, on the way to a descent."""

    best: Outcome
    races: int = 0
    """Batches that raced."""


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
        self._outcomes: list[Outcome] = []
        self._asked = 0
        self._descent: Descent | None = None
        self._base = _Base(self._best, -math.inf)
        self._hops: _Hops | None = None

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
        """(n,) what steps and hops must exceed; minus infinity for what is wanted whole."""
        return np.array(self._to_beat())

    def _to_beat(self) -> list[float]:
        """Return what each candidate that was handed out must exceed."""
        taken = len(self._outcomes)
        if self._hops is not None:
            episodes, _, _ = self._hops.best.misses.shape
            return [self._hops.best.value if episodes == 1 else -math.inf] * self._asked
        if self._phase is not _Phase.STEPS or self._descent is None:
            return [-math.inf] * self._asked
        steps = len(self._batch) - 1
        to_beat = self._descent.to_beat
        return [to_beat if number < steps else -math.inf for number in range(taken, taken + self._asked)]

    def ask(self, count: int = 1) -> Vector:
        """Return the next candidates (n, P), 1 <= n <= count, at most what is left of the batch."""
        if self._asked:
            raise RuntimeError("ask() again before tell()")
        if count < 1:
            raise ValueError(f"at least one candidate must be asked for, got {count}")
        points = self._batch[len(self._outcomes) :][:count]
        self._asked = len(points)
        return self._box.vectors(points)

    def tell(self, values: Sequence[float] | Vector, misses: Vector | None = None) -> int:
        """Take the returns (n,) and misses (n, E, C, 3) of what ``ask`` gave; return n, as all count."""
        if misses is None:
            raise ValueError("this search needs the misses")
        if not len(values) == len(misses) == self._asked:
            raise ValueError(f"{self._asked} candidates wait for their returns, got {len(values)}")
        numbers = np.asarray(values, np.float64).tolist()
        if any(map(math.isnan, numbers)):
            raise ValueError("a return is not a number")
        to_beat, points = self._to_beat(), self._batch[len(self._outcomes) :]
        for point, value, row, least in zip(points, numbers, np.array(misses), to_beat, strict=False):
            outcome = stopped(Outcome(point, value, row), least)
            self._outcomes.append(outcome)
            self.evaluations += 1
            if self.value is None or outcome.value > self.value:
                self.value, self._best = outcome.value, outcome.point
        asked, self._asked = self._asked, 0
        if len(self._outcomes) == len(self._batch):
            outcomes, self._outcomes = self._outcomes, []
            self._decide(outcomes)
        return asked

    def _decide(self, outcomes: list[Outcome]) -> None:
        """Take in a batch and draw the next one."""
        if self._descent is None:
            self._start(outcomes)
        elif self._phase is _Phase.FAR:
            if self._descent.wake(outcomes):
                self._measure_slopes()
            else:
                self._draw_samples(self._descent.at)
        elif self._phase is _Phase.SLOPES:
            for probe in outcomes:
                self._descent.measure(probe)
            self._step()
        else:
            *steps, probe = outcomes
            self._descent.measure(probe)
            assert self.value is not None
            to_overtake = self._base.value if self._descent.hopped else self.value
            if self._descent.take(steps) and self._descent.overtakes(to_overtake):
                self._step()
            elif self._descent.survives and self._descent.woken < MOST_WOKEN and self._descent.silent.size:
                self._phase, self._batch = _Phase.FAR, self._descent.far_probes()
            else:
                self._draw_samples(self._descent.at)

    def _start(self, outcomes: list[Outcome]) -> None:
        """Take in what a descent may start from."""
        if self._phase is _Phase.START:
            self._draw_samples(outcomes[0])
        elif self._phase is _Phase.HOPS:
            self._race(max(outcomes, key=lambda outcome: outcome.value))
        else:
            self._descend(outcomes)

    def _step(self) -> None:
        assert self._descent is not None
        self._phase = _Phase.STEPS
        steps = len(self._descent.boldness)
        self._batch = np.empty((steps + 1, self._box.size))
        self._descent.write_targets(self._batch[:steps])
        self._write_probes(self._batch[steps:], [self.evaluations // (steps + 1) % self._box.size])

    def _draw_samples(self, last: Outcome) -> None:
        """Draw the samples from which the next descent will start, ``last`` being where one ended."""
        hopped = self._descent is not None and self._descent.hopped
        self._descent = None
        if self._hops_after(last, hopped):
            self._phase = _Phase.HOPS
            self._draw_hops(self._is_good(last))
        else:
            self._phase = _Phase.SAMPLES
            moves = SPREAD * self._generator.standard_normal((SAMPLES, self._box.size))
            self._batch = reflected(self._box.start + moves)

    def _draw_hops(self, wide: bool) -> None:
        share = WIDE_HOP_SHARE if wide else HOP_SHARE
        moved = self._generator.random((HOPS, self._box.size)) < share
        moves = HOP_SPREAD * self._generator.standard_normal(moved.shape)
        self._batch = reflected(self._base.point + np.where(moved, moves, 0.0))

    def _race(self, hop: Outcome) -> None:
        """Take in the best of a batch of hops; draw others to race against it, or descend from it."""
        hops = self._hops
        if hops is None:
            hops = self._hops = _Hops(hop)
        else:
            hops.races += 1
            if hop.value > hops.best.value:
                hops.best = hop
        if hops.races < HOP_RACES and self._is_good(hop):
            self._draw_hops(wide=True)
        else:
            self._hops = None
            self._descend([hops.best])

    def _is_good(self, outcome: Outcome) -> bool:
        """Return whether the best is good, as for so many checkpoints as an outcome has."""
        assert self.value is not None
        _, checkpoints, _ = outcome.misses.shape
        good: bool = -self.value < GOOD_M2 * checkpoints
        return good

    def _hops_after(self, last: Outcome, hopped: bool) -> bool:
        """Choose where hops go from, and return whether one comes next."""
        assert self.value is not None
        _, checkpoints, _ = last.misses.shape
        best = _Base(self._best, self.value)
        if not hopped:
            self._base = best if last.value < NEAR_BEST * self.value else _Base(last.point, last.value)
        elif last.value > (1.0 - FRUITFUL) * self._base.value:
            self._base = _Base(last.point, last.value)
        else:
            self._base.fruitless += 1
            if last.value > self._base.value:
                self._base.point, self._base.value = last.point, last.value
        if self._is_good(last):
            self._base = best
            return True
        patience = PATIENCE if -self._base.value < CLOSE_M2 * checkpoints else 1
        return -self.value < FAIR_M2 * checkpoints and self._base.fruitless < patience

    def _descend(self, samples: list[Outcome]) -> None:
        """Begin a descent from the best sample: measure all slopes there."""
        hopped = self._phase is _Phase.HOPS
        slopes = np.zeros((self._box.size, samples[0].misses.size))
        self._descent = descent = Descent(samples[0], not hopped, hopped, slopes, FIRST_DAMPING, [])
        scores = [descent.score(sample) for sample in samples]
        best = max(range(len(samples)), key=scores.__getitem__)
        descent.at, descent.scores = samples[best], [scores[best]]
        self._measure_slopes()

    def _measure_slopes(self) -> None:
        self._phase = _Phase.SLOPES
        self._batch = np.empty((self._box.size, self._box.size))
        self._write_probes(self._batch, range(self._box.size))

    def _write_probes(self, probes: Vector, parameters: Sequence[int]) -> None:
        """Write the descent's point with one parameter moved, up or down, within the box: (n, D)."""
        assert self._descent is not None
        point = self._descent.at.point
        probes[:] = point
        draws = self._generator.random(len(parameters)).tolist()
        for probe, parameter, draw in zip(probes, parameters, draws, strict=True):
            here = float(point[parameter])
            there = here + (PROBE if draw < 0.5 else -PROBE)
            if there > 1.0:
                there = here - PROBE
            elif there < 0.0:
                there = here + PROBE
            probe[parameter] = there

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
            "values": [outcome.value for outcome in self._outcomes],
            "misses": pack(np.array([outcome.misses for outcome in self._outcomes])),
            "hops": self._hops and {**_packed(self._hops.best), "races": self._hops.races},
            "base": None if self.value is None else {**asdict(self._base), "point": pack(self._base.point)},
            "descent": descent
            and {
                **_packed(descent.at),
                "survives": descent.survives,
                "hopped": descent.hopped,
                "slopes": pack(descent.slopes),
                "damping": descent.damping,
                "scores": list(descent.scores),
                "woken": descent.woken,
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
            _Phase.STEPS: None,
            _Phase.FAR: None,
        }
        batch = unpack(state["batch"], (sizes[phase], self._box.size))
        values = [float(value) for value in state["values"]]
        misses = unpack(state["misses"], (None, None, None, 3) if values else (0,))
        if len(misses) != len(values) or len(values) >= len(batch):
            raise ValueError(f"{len(values)} of a batch of {len(batch)} cannot have been evaluated")
        descent = self._restored_descent(state["descent"])
        if (descent is None) == (phase in (_Phase.SLOPES, _Phase.STEPS, _Phase.FAR)):
            raise ValueError(f"a descent does not go with the phase {phase}")
        if descent is not None and phase is _Phase.STEPS and len(batch) != len(descent.boldness) + 1:
            raise ValueError(f"a batch of {len(batch)} cannot be")
        hops = self._restored_hops(state["hops"])
        if hops is not None and phase is not _Phase.HOPS:
            raise ValueError(f"hops do not go with the phase {phase}")
        base = self._restored_base(state["base"])
        if (base is None) != (value is None):
            raise ValueError("a base does not go with no return")
        self._generator.bit_generator.state = state["generator"]
        self.value, self.evaluations, self._best = value, evaluations, best
        self._phase, self._batch, self._descent, self._asked = phase, batch, descent, 0
        self._base, self._hops = base or _Base(best, -math.inf), hops
        self._outcomes = [Outcome(*fields) for fields in zip(batch, values, misses, strict=False)]

    def _restored_outcome(self, state: Mapping[str, Any]) -> Outcome:
        point, misses = unpack(state["point"], (self._box.size,)), unpack(state["misses"], (None, None, 3))
        return Outcome(point, float(state["value"]), misses)

    def _restored_hops(self, state: Mapping[str, Any] | None) -> _Hops | None:
        if state is None:
            return None
        hops = _Hops(self._restored_outcome(state), int(state["races"]))
        if not math.isfinite(hops.best.value) or not 0 <= hops.races < HOP_RACES:
            raise ValueError("hops of such a return cannot be")
        return hops

    def _restored_base(self, state: Mapping[str, Any] | None) -> _Base | None:
        if state is None:
            return None
        base = _Base(
            unpack(state["point"], (self._box.size,)), float(state["value"]), int(state["fruitless"])
        )
        if not math.isfinite(base.value) or base.fruitless < 0:
            raise ValueError("a base of such a return cannot be")
        return base

    def _restored_descent(self, state: Mapping[str, Any] | None) -> Descent | None:
        if state is None:
            return None
        at = self._restored_outcome(state)
        descent = Descent(
            at=at,
            survives=bool(state["survives"]),
            hopped=bool(state["hopped"]),
            slopes=unpack(state["slopes"], (self._box.size, at.misses.size)),
            damping=float(state["damping"]),
            scores=[float(score) for score in state["scores"]],
            woken=int(state["woken"]),
        )
        if not 1 <= len(descent.scores) <= WINDOW + 1 or not 0.0 < descent.damping <= MOST_DAMPING:
            raise ValueError("a descent of such scores or damping cannot be")
        return descent


def _packed(outcome: Outcome) -> dict[str, Any]:
    return {
        "point": pack(outcome.point),
        "value": outcome.value,
        "misses": pack(outcome.misses),
    }
