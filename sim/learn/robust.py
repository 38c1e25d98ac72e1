"""Training on robots nobody measured: CMA-ES on the mean of a smooth cost over random trials and courses.

A generation's candidates all drive the same trials (common random numbers), so that what tells them apart is
not luck; the next generation drives others, so that none is learned by heart. Early generations drive fewer
trials: far from the goal a rough estimate will do. The winner is the mean of the last distribution, which no
single lucky trial made.

Numbers are searched in the unit cube: conductances of leaks and capacitances, which span decades, by their
logarithm, all else linearly. Those of neurons that are driven decide nothing and stay.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.circuit import ParameterKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.course import Course
from rover_ncp.core.reference import Reference
from sim.learn.engine import Engine, Outcomes
from sim.learn.objective import mean_of_worst
from sim.world.random_course import mirrored, mirrored_reference, random_course
from sim.world.randomization import Randomization, draw_trials
from sim.world.rover import RoverModel

__all__ = ["Cube", "Generation", "UnitCube", "costs", "robust_search", "training_courses"]

FloatArray = NDArray[np.float64]

_FIRST_SPREAD = 0.04
_ROLLOUTS_SHARE = ((0.2, 4), (0.5, 2), (1.0, 1))
"""Up to this share of the generations, that fraction of the rollouts."""
_COURSES_APART = 10**9
"""Training courses have seeds from here on, evaluations smaller ones: no course is in both."""
_RANDOM_BETWEEN = 3
"""So many random courses follow each turn of the given one, which goes to the left and to the right."""


class Generation(NamedTuple):
    """Where a search stands: after how many generations, the mean (P,), the spread, the best cost in it."""

    number: int
    mean: FloatArray
    spread: float
    best: float


class Cube(Protocol):
    """What is searched, as numbers in 0..1."""

    @property
    def start(self) -> FloatArray:
        """(A,) where the search begins."""

    def vector(self, place: FloatArray) -> FloatArray:
        """Return what the engine takes, for a place (A,), which is moved into the cube if need be."""


class UnitCube:
    """The parameters of a policy that decide something, each as a number in 0..1."""

    def __init__(self, policy: Policy) -> None:
        layout = policy.layout()
        kinds = np.repeat([str(block.kind) for block in layout.blocks], [b.size for b in layout.blocks])
        self._start = policy.parameters()
        self._lower, self._upper = layout.lower, layout.upper
        self._log = np.isin(kinds, [ParameterKind.LEAK, ParameterKind.CAPACITANCE])
        self.active = np.ones(layout.size, np.bool_)
        driven = [policy.circuit.index(neuron) for neuron in policy.sensing.neurons]
        for kind in (ParameterKind.LEAK_POTENTIAL, ParameterKind.LEAK, ParameterKind.CAPACITANCE):
            self.active[layout.block(kind).slice.start + np.array(driven)] = False

    @property
    def start(self) -> FloatArray:
        """(A,) where the policy itself is."""
        low, high = self._scaled(self._lower), self._scaled(self._upper)
        place: FloatArray = (self._scaled(self._start) - low) / (high - low)
        return place[self.active]

    def vector(self, place: FloatArray) -> FloatArray:
        """Return the parameter vector (P,) at a place (A,), which is moved into the cube if need be."""
        low, high = self._scaled(self._lower), self._scaled(self._upper)
        scaled = self._scaled(self._start)
        part = np.clip(place, 0.0, 1.0)
        scaled[self.active] = low[self.active] + part * (high - low)[self.active]
        vector = np.where(self._log, np.exp(np.where(self._log, scaled, 0.0)), scaled)
        return np.where(self.active, np.clip(vector, self._lower, self._upper), self._start)

    def _scaled(self, vector: FloatArray) -> FloatArray:
        return np.where(self._log, np.log(np.where(self._log, vector, 1.0)), vector)


def costs(found: Outcomes) -> FloatArray:
    """Return a cost (candidates, trials) of each episode: smooth, and steepest where parked ends.

    Errors count by the logarithm, so that a lost trial does not outweigh many good ones; what parked means
    is the course's rule as it is by default, a little tightened and blurred.
    """
    near = (
        _log_square(found.error_m / 0.1)
        + _log_square(found.error_rad / 0.1)
        + _log_square(found.moved_m / 0.005)
        + _log_square(found.turned_rad / 0.005)
    )
    on_the_way = 0.2 * np.log1p(found.tracking_m2 / 0.05**2) + 0.1 * np.log1p(found.tracking_rad2 / 0.1**2)
    failed = np.maximum.reduce(
        [
            _blurred(found.error_m, 0.09, 0.012),
            _blurred(found.error_rad, 0.09, 0.012),
            _blurred(found.moved_m, 0.005, 0.0005),
            _blurred(found.turned_rad, 0.005, 0.0005),
        ]
    )
    cost: FloatArray = 0.5 * near + on_the_way + 6.0 * failed
    return cost


def _log_square(part: FloatArray) -> FloatArray:
    squared: FloatArray = np.log1p(4.0 * part * part)
    return squared


def _blurred(error: FloatArray, limit: float, width: float) -> FloatArray:
    """Return about 0 below a limit and 1 above."""
    beyond: FloatArray = 1.0 / (1.0 + np.exp(np.clip((limit - error) / width, -50.0, 50.0)))
    return beyond


def training_courses(
    given: Course, planned: Reference, seed: int, count: int
) -> tuple[list[Course], list[Reference]]:
    """Return ``count`` random courses of a seed, their references, and among them those of the given one.

    The given one also comes mirrored: a circuit, unlike a law, has to learn left and right apart. Alone it
    is when ``count`` is 0.
    """
    turns = ((given, planned), (mirrored(given), mirrored_reference(planned)))
    pairs = []
    for number in range(count):
        if number % _RANDOM_BETWEEN == 0:
            pairs.append(turns[number // _RANDOM_BETWEEN % 2])
        pairs.append(random_course(_COURSES_APART + seed, number))
    pairs = pairs or [turns[0]]
    return [course for course, _ in pairs], [reference for _, reference in pairs]


def robust_search(
    engine: Engine,
    cube: Cube,
    ranges: Randomization,
    *,
    seed: int,
    generations: int,
    rollouts: int,
    worst: int,
    model: RoverModel,
) -> Iterator[Generation]:
    """Search from the cube's start; yields after every generation. The same seed gives the same search."""
    from cmaes import CMA

    ticks = max(course.ticks for course in engine.courses)
    optimizer = CMA(
        mean=cube.start,
        sigma=_FIRST_SPREAD,
        bounds=np.tile([0.0, 1.0], (len(cube.start), 1)),
        seed=seed,
        population_size=round(1.3 * (4 + 3 * np.log(len(cube.start)))),
    )
    fraction = _fractions(generations)
    for number in range(generations):
        count = max(rollouts // fraction(number), 1)
        trials = draw_trials(
            ranges, model, _COURSES_APART + seed, count=count, ticks=ticks, first=number * rollouts
        )
        engine.change_trials(trials)
        places = [optimizer.ask() for _ in range(optimizer.population_size)]
        found = costs(engine.outcomes([cube.vector(place) for place in places]))
        least = max(worst // fraction(number), 1)
        values = [-mean_of_worst((-row).tolist(), least) for row in found]
        optimizer.tell(list(zip(places, values, strict=True)))
        yield Generation(number + 1, cube.vector(optimizer.mean), float(optimizer._sigma), min(values))


def _fractions(generations: int) -> Callable[[int], int]:
    def fraction(number: int) -> int:
        return next(part for share, part in _ROLLOUTS_SHARE if number < share * generations)

    return fraction
