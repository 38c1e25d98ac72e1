"""The parking tasks: the project's own engine, and its default search, which learns from every miss.

All agents of these rows are searched alike. The published search gets there, too, but takes some ten times
as long (``rover-ncp bench search``).

The paper's return does not ask for standing still, so the search also counts how far a rover still moves
between the last two checkpoints; one that can drive backward comes to stand only where forward and backward
cancel. That is ours, and no part of the returns that are reported.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import load_course
from sim.learn.evaluator import Evaluator
from sim.learn.net_engine import NetEngine
from sim.learn.networks import Net
from sim.learn.search.base import Vector
from sim.learn.search.strategies import STRATEGIES
from sim.paper.agents import inert
from sim.paper.search import Budget, Found
from sim.paper.tasks import Task

_SEARCH, _PUBLISHED_SEARCH = "gauss-newton", "published"
_CREEP = 5.0
"""Weight of creeping for 9 s in terms of a miss: 5 mm in 2 s, which is not parked any more, cost 0.013."""


class ParkingOutcome(NamedTuple):
    """Outcome of the one drive, which is deterministic."""

    total: float
    parked: bool


class ParkingArena:
    """Scores parameter vectors of one agent by the course. One thread at a time."""

    def __init__(self, task: Task, agent: Policy | Net) -> None:
        course = load_course("parking")
        self.task, self.steps = task, 0
        self.engine = (
            Evaluator(agent, course)
            if isinstance(agent, Policy)
            else NetEngine(agent, task.policy(task.circuit()), course)
        )

    def outcome(self, vector: Vector) -> ParkingOutcome:
        """Return what parameters (P,) do."""
        found = self.engine.outcomes(vector)
        return ParkingOutcome(float(found.total[0, 0]), bool(found.parked[0, 0]))

    def traces(self, vectors: Vector) -> tuple[Vector, Vector]:
        """Return the returns (k,) and misses of vectors (k, P), counting steps."""
        self.steps += len(vectors) * self.task.horizon
        return self.engine.traces(vectors)

    def traces_standing(self, vectors: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the returns (k,), and what the search is to climb: a return (k,) and its misses.

        Creeping counts as one more miss.
        """
        values, misses = self.traces(vectors)
        creep = _CREEP * (misses[:, :, -1:] - misses[:, :, -2:-1])
        counted = values - np.sum(creep**2, axis=(1, 2, 3))
        return values, counted, np.concatenate([misses, creep], axis=2)

    def returns(self, vectors: Vector, to_beat: Vector) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat`` (k,)."""
        self.steps += len(vectors) * self.task.horizon
        return self.engine.returns(vectors, to_beat)


def search_parking(
    arena: ParkingArena,
    agent: Policy | Net,
    seed: int,
    budget: Budget,
    on_progress: Callable[[int, float], None] = lambda steps, value: None,
) -> Found:
    """Search an agent's parameters on the parking course. The same arguments give the same bits.

    A return says little about whether the rover stands at the end. So the result is the best candidate that
    parks, if any does.
    """
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(0,))))
    first = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
    strategy = _PUBLISHED_SEARCH if budget.published else _SEARCH
    search = STRATEGIES[strategy].begin(agent.layout(), first, generator, inert(agent))
    curve: list[tuple[int, float]] = []
    ended, parks, best = "evaluations", None, -math.inf
    while search.evaluations < budget.evaluations:
        if arena.steps >= budget.steps:
            ended = "steps"
            break
        ahead = min(search.most_ahead, budget.evaluations - search.evaluations)
        vectors, before = search.ask(ahead), search.value
        if search.needs_misses:
            values, counted, misses = arena.traces_standing(vectors)
            search.tell(counted, misses)
        else:
            values = counted = arena.returns(vectors, search.to_beat)
            search.tell(counted)
        if search.value == before:
            continue
        best = float(values[int(np.argmax(counted))])
        curve.append((arena.steps, best))
        on_progress(arena.steps, best)
        if best >= arena.task.success and arena.outcome(search.incumbent).parked:
            parks = search.incumbent
            if best >= arena.task.enough and not budget.published:
                ended = "enough"
                break
    return Found(search.incumbent if parks is None else parks, search.evaluations, tuple(curve), ended)
