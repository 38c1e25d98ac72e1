"""How candidates reach an objective and their returns come back: agent by agent, in any order."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from sim.learn.objective import Objective
from sim.learn.search.base import Vector


class Answer(NamedTuple):
    """Results of the n candidates that an agent submitted; the arrays may change when it submits again."""

    agent: int
    values: Vector
    """(n,)."""
    misses: Vector | None
    """(n, E, C, 3), of those that were not stopped."""


class Flow(Protocol):
    """Takes the candidates of agents 0, 1, 2 ..., and answers each of them once, some time."""

    room: int
    """The most candidates that an agent may submit at once."""
    enough: int
    """The number of candidates of each agent that keeps all lanes busy."""

    def submit(self, agent: int, vectors: Vector, to_beat: Vector, keys: Sequence[tuple[int, ...]]) -> None:
        """Take candidates (n, P) of an agent that waits for no answer; the rest as in ``Objective``."""

    def collect(self) -> list[Answer]:
        """Return at least one answer, if anybody waits."""


class Lockstep:
    """Evaluates what all agents have submitted as one batch."""

    room = 1000
    enough = 3

    def __init__(self, objective: Objective, needs_misses: bool) -> None:
        self._objective = objective
        self._needs_misses = needs_misses
        self._waiting: list[tuple[int, Vector, Vector, Sequence[tuple[int, ...]]]] = []

    def submit(self, agent: int, vectors: Vector, to_beat: Vector, keys: Sequence[tuple[int, ...]]) -> None:
        """Keep candidates for the next batch."""
        self._waiting.append((agent, vectors, to_beat, keys))

    def collect(self) -> list[Answer]:
        """Return all answers."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return []
        agents, vectors, to_beat, keys = zip(*waiting, strict=True)
        misses = None
        if self._needs_misses:
            values, misses = self._objective.trace(np.concatenate(vectors))
        else:
            every = [key for part in keys for key in part]
            values = self._objective.estimate(np.concatenate(vectors), np.concatenate(to_beat), every)
        answers, first = [], 0
        for agent, part in zip(agents, vectors, strict=True):
            own = slice(first, first + len(part))
            answers.append(Answer(agent, values[own], None if misses is None else misses[own]))
            first += len(part)
        return answers
