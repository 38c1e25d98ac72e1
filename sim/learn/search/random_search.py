"""Random searches: one incumbent, candidates near it, and their comparison.

Candidates are new arrays. The incumbent is replaced as a whole or stays as it is, to the last bit.

Asking for several candidates at once is speculation: each is drawn as if those before it had failed. ``tell``
takes returns up to the first success, drops the rest, and resets the generator to where it was after that
success was drawn. The decisions are therefore those of asking one by one.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import ParameterLayout
from sim.learn.search.base import SearchState, Vector

_START_NOISE: Mapping[ParameterKind, tuple[int, float]] = {
    ParameterKind.WEIGHT: (15, 0.5),
    ParameterKind.SIGMA: (10, 0.2),
    ParameterKind.LEAK_POTENTIAL: (8, 8.0),
    ParameterKind.LEAK: (8, 0.2),
    ParameterKind.CAPACITANCE: (10, 0.1),
    # Parking has no layers. Ours: a layer's entries are weights too.
    ParameterKind.INPUT_LAYER: (15, 0.5),
    ParameterKind.OUTPUT_LAYER: (15, 0.5),
}
"""Changes of each kind at the start and their standard deviation; the published parking search."""


def perturb(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
    """Return the defaults (P,) with noise on some entries of each kind, so that no two agents start alike."""
    vector = np.array(defaults, dtype=np.float64)
    for block in layout.blocks:
        changes, deviation = _START_NOISE[block.kind]
        entries = generator.integers(block.slice.start, block.slice.stop, changes)
        np.add.at(vector, entries, generator.normal(0.0, deviation, changes))
    return np.minimum(np.maximum(vector, layout.lower), layout.upper)


class Adaptation(Protocol):
    """The adaptive state of a search: a frozen dataclass that follows the outcomes."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def after_success(self) -> Self:
        """Return the value after a candidate that beat the incumbent."""

    def after_failure(self) -> Self:
        """Return the value after a candidate that did not."""


AdaptationT = TypeVar("AdaptationT", bound=Adaptation)


@dataclass(frozen=True)
class _Draw(Generic[AdaptationT]):
    """A vector that was handed out, the adaptation it was drawn with and the generator's state after it."""

    vector: Vector
    adaptation: AdaptationT
    generator: Mapping[str, Any] | None = None
    is_estimate: bool = False


class RandomSearch(ABC, Generic[AdaptationT]):
    """A search that maximises a return from one incumbent; the start (P,) is the first."""

    # A lane or two for each agent, and one candidate that waits: more would be drawn and discarded.
    max_ahead: ClassVar[int] = 3
    speculates: ClassVar[bool] = True

    def __init__(self, layout: ParameterLayout, start: Vector, generator: np.random.Generator) -> None:
        self.lower, self.upper = layout.lower, layout.upper
        self.incumbent = np.array(start, dtype=np.float64)
        if not np.all((self.incumbent >= self.lower) & (self.incumbent <= self.upper)):
            raise ValueError(f"expected {self.lower.size} numbers within their bounds")
        self.value: float | None = None
        self.evaluations = 0
        self.adaptation = self.first_adaptation(layout)
        self._generator = generator
        self._pending: list[_Draw[AdaptationT]] = []

    @classmethod
    def begin(
        cls,
        layout: ParameterLayout,
        defaults: Vector,
        generator: np.random.Generator,
        inert: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Begin at the search's ``first`` candidate; inert parameters are changed like all others."""
        return cls(layout, cls.first(layout, defaults, generator), generator)

    @staticmethod
    def first(layout: ParameterLayout, defaults: Vector, generator: np.random.Generator) -> Vector:
        """Return the first candidate (P,): the perturbed defaults (P,)."""
        return perturb(layout, defaults, generator)

    @abstractmethod
    def first_adaptation(self, layout: ParameterLayout) -> AdaptationT:
        """Return the adaptation of the first candidate."""

    @abstractmethod
    def propose(self, adaptation: AdaptationT, generator: np.random.Generator) -> Vector:
        """Draw one candidate (P,) near the incumbent, within bounds: a new array."""

    def wants_estimate(self, adaptation: AdaptationT) -> bool:
        """Whether the incumbent's own return should be measured again before the next candidate."""
        return False

    def after_estimate(self, adaptation: AdaptationT) -> AdaptationT:
        """Return the adaptation after the incumbent's return was measured again."""
        return adaptation

    def clip(self, vector: Vector) -> Vector:
        """Return the vector (P,) with each entry moved to its nearest allowed value."""
        return np.minimum(np.maximum(vector, self.lower), self.upper)

    @property
    def iterations(self) -> int:
        """Returns taken after that of the start: candidates, and new estimates of the incumbent."""
        return max(self.evaluations - 1, 0)

    @property
    def to_beat(self) -> Vector:
        """(n,) what the returns of the vectors handed out must exceed; minus infinity for estimates."""
        exact = self.value is None or (self._pending and self._pending[0].is_estimate)
        return np.full(len(self._pending), -math.inf if exact else self.value)

    def ask(self, count: int = 1) -> Vector:
        """Return candidates (n, P), 1 <= n <= count, whose returns may be measured in any order.

        Fewer than ``count`` come where the next one depends on more than success or failure: the start,
        and a new estimate of the incumbent, stand alone.
        """
        if self._pending:
            raise RuntimeError("ask() again before tell()")
        if count < 1:
            raise ValueError(f"at least one candidate must be asked for, got {count}")
        adaptation = self.adaptation
        if self.value is None or self.wants_estimate(adaptation):
            self._pending = [_Draw(self.incumbent.copy(), adaptation, is_estimate=True)]
            return self.incumbent[None].copy()
        while len(self._pending) < count:
            vector = self.propose(adaptation, self._generator)
            generator = self._generator.bit_generator.state if count > 1 else None
            self._pending.append(_Draw(vector, adaptation, generator))
            adaptation = adaptation.after_failure()
            if self.wants_estimate(adaptation):
                break
        return np.array([draw.vector for draw in self._pending])

    def tell(self, values: Sequence[float] | Vector, residuals: Vector | None = None) -> int:
        """Take the returns (n,) of what ``ask`` gave, in its order; return how many of them counted.

        Only a return strictly greater than the incumbent's counts as a success. Any value that is not
        gives the same decisions, so a rollout may be truncated as soon as success is out of its reach.
        """
        if len(values) != len(self._pending):
            raise ValueError(f"{len(self._pending)} candidates wait for their returns, got {len(values)}")
        pending, self._pending = self._pending, []
        for number, (draw, value) in enumerate(zip(pending, map(float, values), strict=True), start=1):
            self.evaluations += 1
            if draw.is_estimate:
                self._estimated(value)
            elif self.value is not None and value > self.value:
                self.value, self.incumbent = value, draw.vector
                self.adaptation = draw.adaptation.after_success()
                if draw.generator is not None:
                    self._generator.bit_generator.state = draw.generator
                return number
            else:
                self.adaptation = draw.adaptation.after_failure()
        return len(pending)

    def _estimated(self, value: float) -> None:
        if not math.isfinite(value):
            raise ValueError(f"the incumbent's return is {value}: no candidate could be compared with it")
        if self.value is not None:
            self.adaptation = self.after_estimate(self.adaptation)
        self.value = value

    def state(self) -> SearchState:
        """Return all that the next ``ask`` depends on; only between ``tell`` and ``ask``."""
        if self._pending:
            raise RuntimeError("state() between ask() and tell()")
        return {
            "evaluations": self.evaluations,
            "value": self.value,
            "incumbent": self.incumbent.tolist(),
            "adaptation": asdict(self.adaptation),
            "generator": self._generator.bit_generator.state,
        }

    def restore(self, state: SearchState) -> None:
        """Continue from a ``state()``."""
        self.evaluations, self.value = state["evaluations"], state["value"]
        self.incumbent = np.array(state["incumbent"])
        self._generator.bit_generator.state = state["generator"]
        # JSON has lists for tuples.
        fields = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in state["adaptation"].items()
        }
        self.adaptation = replace(self.adaptation, **fields)
