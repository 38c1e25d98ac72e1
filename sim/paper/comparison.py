"""Run against run: the tap-withdrawal circuit and another agent on each task.

Returns are far from normal (a run balances or falls), so the test is a permutation test of the difference of
means. Holm's procedure corrects for the number of tasks. Effect sizes: the difference of means with its
bootstrap interval, and the probability that a run of the circuit is better than one of the other agent, ties
counted by half.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import UsageError
from sim.paper.agents import AGENTS, CLONED
from sim.paper.results import ResultStore
from sim.paper.tables import LEVEL, markdown, mean_text
from sim.paper.tasks import TASKS

OTHERS = tuple(agent for agent in AGENTS[1:] if agent not in CLONED)
_RESAMPLES = 9999
_SEED = 20
"""A table is the same each time."""


class Effect(NamedTuple):
    """A test of two sets of runs, and how far they lie apart."""

    difference: float
    """Of the means."""
    interval: tuple[float, float]
    """Of the difference, 95 %."""
    probability: float
    """That a run of the first set has the higher return."""
    p: float

    def sentence(self, runs: int, other_runs: int) -> str:
        """Return test, n, p and effect size in a line."""
        low, high = map(mean_text, self.interval)
        return (
            f"difference {mean_text(self.difference)} ({low} .. {high}), P(above) {self.probability:.2f}; "
            f"permutation test, n = {runs} and {other_runs}, p = {self.p:.2g}"
        )


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
        fields, (low, high) = self.fields(), map(mean_text, self.effect.interval)
        return (
            TASKS[self.task].title,
            self.other,
            f"{self.runs[0]}, {self.runs[1]}",
            f"{mean_text(self.means[0])}, {mean_text(self.means[1])}",
            f"{self.successes[0]}, {self.successes[1]}",
            f"{mean_text(self.effect.difference)} ({low} .. {high})",
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


def measure(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> Effect:
    """Compare two sets of returns, (n,) and (m,)."""
    from scipy.stats import bootstrap, mannwhitneyu, permutation_test

    if np.ptp(np.concatenate([ours, theirs])) == 0.0:
        return Effect(0.0, (0.0, 0.0), 0.5, 1.0)
    rng = np.random.default_rng(_SEED)
    test = permutation_test((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng)
    ends = bootstrap((ours, theirs), _difference, n_resamples=_RESAMPLES, rng=rng).confidence_interval
    above = float(mannwhitneyu(ours, theirs).statistic) / (len(ours) * len(theirs))
    return Effect(float(test.statistic), (float(ends.low), float(ends.high)), above, float(test.pvalue))


def _difference(a: NDArray[np.float64], b: NDArray[np.float64], axis: int = -1) -> Any:
    return a.mean(axis=axis) - b.mean(axis=axis)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number (Holm 1979)."""
    order = np.argsort(p_values)
    scaled = np.array(p_values)[order] * np.arange(len(order), 0, -1)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return [float(p) for p in corrected]


def comparisons_text(found: Sequence[Comparison]) -> str:
    """Return comparisons as Markdown."""
    head = ("task", "circuit and", "runs", "means", "successes", "difference (95 %)")
    return markdown([(*head, "P(above)", "p", "p, Holm", "circuit"), *(row.texts() for row in found)])
