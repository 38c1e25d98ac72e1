"""The parking tasks: the project's own evaluator, and its default search, which learns from every miss.

All agents of these rows are searched alike.

The paper's return does not ask for standing still, so the search also counts how far a rover still moves
between the last two checkpoints. A rover that can drive backward stops only where forward and backward
cancel. This is our addition, and no part of the returns that are reported.
"""

import math

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import load_course
from sim.learn.engine.evaluator import Evaluator
from sim.learn.engine.networks import Net, network_commander
from sim.learn.search.base import Vector
from sim.learn.search.strategies import start_search
from sim.paper.agents import dead_parameters
from sim.paper.search.estimate import Budget, Found, Point, generator_of
from sim.paper.tasks import Task

_CREEP = 5.0
"""Weight of creeping for 9 s in terms of a miss: 5 mm in 2 s, which is not parked any more, cost 0.013."""


class ParkingEvaluator:
    """Scores parameter vectors of one agent by the course, without chance. One thread at a time."""

    def __init__(self, task: Task, agent: Policy | Net) -> None:
        course = load_course("parking")
        self.task, self.steps = task, 0
        self.engine = (
            Evaluator(agent, course)
            if isinstance(agent, Policy)
            else Evaluator(task.policy(task.circuit()), course, commander=network_commander(agent))
        )

    def outcome(self, vector: Vector) -> tuple[float, bool]:
        """Return the return of parameters (P,) and whether they park."""
        found = self.engine.outcomes(vector)
        return float(found.total[0, 0]), bool(found.parked[0, 0])

    def traces(self, vectors: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the returns (k,) of vectors (k, P), and the return and residuals that the search climbs.

        Creeping counts as one more miss.
        """
        self.steps += len(vectors) * self.task.horizon
        values, residuals = self.engine.run(vectors)
        creep = _CREEP * (residuals[:, :, -1:] - residuals[:, :, -2:-1])
        counted = values - np.sum(creep**2, axis=(1, 2, 3))
        return values, counted, np.concatenate([residuals, creep], axis=2)

    def estimate(self, vectors: Vector, number: int, to_beat: Vector) -> Vector:
        """Return the returns (k,) of vectors (k, P), exact only above ``to_beat`` (k,).

        Without chance, the ``number`` of an evaluation does not matter.
        """
        self.steps += len(vectors) * self.task.horizon
        return self.engine.returns(vectors, to_beat)


def search_parking(evaluator: ParkingEvaluator, agent: Policy | Net, seed: int, budget: Budget) -> Found:
    """Search an agent's parameters on the parking course. The same arguments give the same bits.

    A return says little about whether the rover stands at the end. So the result is the best candidate that
    parks, if any does.
    """
    generator = generator_of(seed)
    first = agent.parameters() if isinstance(agent, Policy) else agent.start(generator)
    search = start_search("gauss-newton", agent.layout(), first, generator, dead_parameters(agent))
    curve: list[Point] = []
    ended, parks, best = "evaluations", None, -math.inf
    while search.evaluations < budget.evaluations:
        if evaluator.steps >= budget.steps:
            ended = "steps"
            break
        ahead = min(search.max_ahead, budget.evaluations - search.evaluations)
        vectors, before = search.ask(ahead), search.value
        values, counted, residuals = evaluator.traces(vectors)
        search.tell(counted, residuals)
        if search.value == before:
            continue
        best = float(values[int(np.argmax(counted))])
        curve.append(Point(search.evaluations, evaluator.steps, best))
        if best >= evaluator.task.success and evaluator.outcome(search.incumbent)[1]:
            parks = search.incumbent
            if best >= evaluator.task.enough:
                ended = "enough"
                break
    return Found(search.incumbent if parks is None else parks, search.evaluations, tuple(curve), ended)
