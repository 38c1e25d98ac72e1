"""Run against run: the tap-withdrawal circuit and another agent on each task.

Returns are far from normal (a run balances or falls), so the test is a permutation test of the difference of
means. Holm's procedure corrects for the number of tasks. Effect sizes: the difference of means with its
bootstrap interval, and the probability that a run of the circuit is better than one of the other agent, ties
counted by half.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rover_ncp.core.errors import UsageError
from sim.paper.agents import AGENTS, CLONED
from sim.paper.results import ResultStore
from sim.paper.significance import LEVEL, Effect, holm, interval_text, mean_text, measure
from sim.paper.tables import markdown
from sim.paper.tasks import TASKS

OTHERS = tuple(agent for agent in AGENTS[1:] if agent not in CLONED)


class Comparison(NamedTuple):
    """The circuit against another agent on one task."""

    task: str
    other: str
    runs: tuple[int, int]
    means: tuple[float, float]
    successes: tuple[int, int]
    effect: Effect
    p_holm: float

    @property
    def better(self) -> bool:
        """Whether the circuit is better beyond chance, corrected for all tasks."""
        return self.p_holm < LEVEL and self.effect.difference > 0.0

    @property
    def worse(self) -> bool:
        """Whether the circuit is worse beyond chance, corrected for all tasks."""
        return self.p_holm < LEVEL and self.effect.difference < 0.0

    def fields(self) -> dict[str, Any]:
        """Return the comparison as ``--json`` prints it."""
        verdict = "better" if self.better else "worse" if self.worse else "no difference found"
        own = {
            name: getattr(self, name) for name in ("task", "other", "runs", "means", "successes", "p_holm")
        }
        return own | self.effect._asdict() | {"test": "permutation", "verdict": verdict}

    def texts(self) -> tuple[str, ...]:
        """Return the comparison's cells as Markdown."""
        fields = self.fields()
        return (
            TASKS[self.task].title,
            self.other,
            f"{self.runs[0]}, {self.runs[1]}",
            f"{mean_text(self.means[0])}, {mean_text(self.means[1])}",
            f"{self.successes[0]}, {self.successes[1]}",
            f"{mean_text(self.effect.difference)} ({interval_text(self.effect.interval)})",
            f"{self.effect.probability:.2f}",
            f"{self.effect.p:.2g}",
            f"{self.p_holm:.2g}",
            fields["verdict"],
        )

    def sentence(self) -> str:
        """Return means, test, n, p and effect size in a line."""
        means = " against ".join(map(mean_text, self.means))
        return f"{means}: {self.effect.sentence(*self.runs)}, by Holm {self.p_holm:.2g}"


def compare_agents(store: ResultStore, other: str) -> list[Comparison]:
    """Compare the circuit on all tasks of which at least two runs of each agent exist.

    Raises FileError, and UsageError for an unknown agent.
    """
    if other not in OTHERS:
        raise UsageError(f"the circuit is compared with {', '.join(OTHERS)}, not with {other!r}")
    pairs = {task: (store.results(task, "circuit"), store.results(task, other)) for task in TASKS}
    pairs = {task: pair for task, pair in pairs.items() if min(map(len, pair)) > 1}
    returns = {
        task: [np.array([result.mean for result in results]) for results in pair]
        for task, pair in pairs.items()
    }
    effects = [measure(*arrays) for arrays in returns.values()]
    corrected = holm([effect.p for effect in effects])
    return [
        Comparison(
            task=task,
            other=other,
            runs=(len(ours), len(theirs)),
            means=(float(ours.mean()), float(theirs.mean())),
            successes=(sum(r.success for r in pairs[task][0]), sum(r.success for r in pairs[task][1])),
            effect=effect,
            p_holm=p_holm,
        )
        for (task, (ours, theirs)), effect, p_holm in zip(returns.items(), effects, corrected, strict=True)
    ]


def comparisons_text(found: Sequence[Comparison]) -> str:
    """Return comparisons as Markdown."""
    head = ("task", "circuit and", "runs", "means", "successes", "difference (95 %)")
    return markdown([(*head, "P(above)", "p", "p, Holm", "circuit"), *(row.texts() for row in found)])
