"""Run against run: the tap-withdrawal circuit and another agent on each task.

Returns are far from normal (a run balances or falls), so the test is a permutation test of the difference of
means. Holm's procedure corrects for the number of tasks. Effect sizes: the difference of means with its
bootstrap interval, and the probability that a run of the circuit is better than one of the other agent, ties
counted by half.

A search ends at a return that is confirmed as enough. Where all runs of both agents end so, the difference of
returns only says where they stopped, and the steps to success are compared.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.core.errors import UsageError
from sim.paper import BudgetName
from sim.paper.agents import AGENTS
from sim.paper.results import Result, ResultStore
from sim.paper.statistics import LEVEL, Effect, holm, interval_text, mean_text, measure
from sim.paper.tables import markdown
from sim.paper.tasks import TASKS

OTHERS = AGENTS[1:]


def steps_to_success(result: Result) -> int:
    """Return the steps after which a run's estimate passes its task's threshold, or all of its steps."""
    enough = TASKS[result.name.task].success
    return next((steps for steps, value in result.curve if value >= enough), result.steps)


class Comparison(NamedTuple):
    """The circuit against another agent on one task."""

    task: str
    other: str
    runs: tuple[int, int]
    means: tuple[float, float]
    successes: tuple[int, int]
    at_limit: bool
    """Whether all runs of both ended at the return that is enough."""
    effect: Effect
    """Of returns, or of steps to success where all runs of both ended at the return that is enough."""
    p_holm: float

    @property
    def better(self) -> bool:
        """Whether the circuit has the higher returns, or fewer steps, beyond chance, corrected for tasks."""
        return self.p_holm < LEVEL and (self.effect.difference < 0.0) == self.at_limit

    @property
    def worse(self) -> bool:
        """Whether the circuit has the lower returns, or more steps, beyond chance, corrected for tasks."""
        return self.p_holm < LEVEL and not self.better

    @property
    def verdict(self) -> str:
        """The difference of the circuit in words."""
        better, worse = ("fewer steps", "more steps") if self.at_limit else ("better", "worse")
        return better if self.better else worse if self.worse else "no difference found"

    def fields(self) -> dict[str, Any]:
        """Return the comparison as ``--json`` prints it."""
        own = {
            name: getattr(self, name)
            for name in ("task", "other", "runs", "means", "successes", "at_limit", "p_holm")
        }
        return own | self.effect._asdict() | {"test": "permutation", "verdict": self.verdict}

    def texts(self) -> tuple[str, ...]:
        """Return the comparison's cells as Markdown."""
        return (
            TASKS[self.task].title,
            self.other,
            f"{self.runs[0]}, {self.runs[1]}",
            f"{mean_text(self.means[0])}, {mean_text(self.means[1])}",
            f"{self.successes[0]}, {self.successes[1]}",
            "steps" if self.at_limit else "return",
            f"{mean_text(self.effect.difference)} ({interval_text(self.effect.interval)})",
            f"{self.effect.probability:.2f}",
            f"{self.effect.p:.2g}",
            f"{self.p_holm:.2g}",
            self.verdict,
        )

    def sentence(self) -> str:
        """Return means, test, n, p and effect size in a line."""
        means = " against ".join(map(mean_text, self.means))
        of = "; steps to success," if self.at_limit else ":"
        return f"{means}{of} {self.effect.sentence(*self.runs)}, by Holm {self.p_holm:.2g}"


def compare_agents(
    store: ResultStore, other: str, budget: BudgetName = BudgetName.DEFAULT
) -> list[Comparison]:
    """Compare the circuit on all tasks of which at least two runs of each agent with a budget exist.

    Raises FileError, and UsageError for an unknown agent.
    """
    if other not in OTHERS:
        raise UsageError(f"the circuit is compared with {', '.join(OTHERS)}, not with {other!r}")
    pairs = {
        task: (store.results(task, "circuit", budget), store.results(task, other, budget)) for task in TASKS
    }
    pairs = {task: pair for task, pair in pairs.items() if min(map(len, pair)) > 1}
    limits = {
        task: all(run.ended == "enough" for runs in pair for run in runs) for task, pair in pairs.items()
    }
    effects = []
    for task, pair in pairs.items():
        of = steps_to_success if limits[task] else _mean
        effects.append(measure(*(np.array([of(run) for run in runs], np.float64) for runs in pair)))
    corrected = holm([effect.p for effect in effects])
    return [
        Comparison(
            task=task,
            other=other,
            runs=(len(ours), len(theirs)),
            means=(float(np.mean([run.mean for run in ours])), float(np.mean([run.mean for run in theirs]))),
            successes=(sum(run.success for run in ours), sum(run.success for run in theirs)),
            at_limit=limits[task],
            effect=effect,
            p_holm=p_holm,
        )
        for (task, (ours, theirs)), effect, p_holm in zip(pairs.items(), effects, corrected, strict=True)
    ]


def _mean(run: Result) -> float:
    return run.mean


def comparisons_text(found: Sequence[Comparison]) -> str:
    """Return comparisons as Markdown."""
    head = ("task", "circuit and", "runs", "means", "successes", "compared", "difference (95 %)")
    return markdown([(*head, "P(above)", "p", "p, Holm", "circuit"), *(row.texts() for row in found)])
