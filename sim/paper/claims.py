"""The paper's claims (``claims.yaml``) and their verdicts, from the stored runs.

Five tests: ``rate`` of successes, ``value`` of a mean, ``compare`` of two agents, ``sign`` of Definition 1,
``fact`` about circuits and settings. A verdict is *reproduced* only where an interval excludes the opposite,
or lies within a stated margin of equality. Holm's correction is for the claims from one place of the paper.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from rover_ncp.core.config import StrictModel, parse_yaml
from rover_ncp.core.files import read_text
from sim.paper import BudgetName
from sim.paper.facts import FACTS
from sim.paper.interpretation import drives, readings
from sim.paper.results import Result, ResultStore
from sim.paper.statistics import LEVEL, Summary, fisher, holm, mean_text, measure, welch, wilson
from sim.paper.tasks import TASKS

CLAIMS = Path(__file__).parent / "claims.yaml"
MIN_RUNS = 5
"""Fewer runs of an agent give no verdict."""
RATE_MARGIN = 0.2
"""Difference of success rates that counts as none."""


class Verdict(StrEnum):
    """Result of a claim's test."""

    REPRODUCED = "reproduced"
    DIFFERS = "differs"
    INCONCLUSIVE = "inconclusive"
    NOT_TESTED = "not tested"


class Test(StrEnum):
    """Name of a test."""

    RATE = "rate"
    VALUE = "value"
    COMPARE = "compare"
    SIGN = "sign"
    FACT = "fact"
    NONE = "none"


class Claim(StrictModel):
    """A claim of the paper and the test that decides on it."""

    name: str
    words: str
    where: str
    test: Test
    arguments: dict[str, Any] = Field(default_factory=dict)
    why: str = ""
    """Reason that a claim is not tested, or a deviation from the paper."""


class ClaimsFile(StrictModel):
    """``claims.yaml``: the page's questions, each with the claims that answer it, and all claims."""

    questions: dict[str, tuple[str, ...]]
    claims: tuple[Claim, ...]


@dataclass(frozen=True)
class Outcome:
    """Result of a test before Holm's correction."""

    figure: str
    runs: str = ""
    p: float | None = None
    holds: bool = False
    """Whether the interval shows the claim: it excludes the opposite, or lies within the margin."""
    significant: bool | None = None
    """What a significant p means: True for the claim, False against it."""
    tested: bool = True


class Judged(StrictModel):
    """A claim with its verdict."""

    name: str = Field(description="short name of the claim")
    words: str = Field(description="what the paper says")
    where: str = Field(description="section, table or figure of the paper")
    verdict: Verdict = Field(description="reproduced, differs, inconclusive or not tested")
    figure: str = Field(description="what was measured")
    why: str = Field(description="the reason of the verdict, or a deviation")

    @property
    def text(self) -> str:
        """Verdict, with its reason where there is one."""
        return f"{self.verdict} ({self.why})" if self.why else str(self.verdict)


def load_claims() -> ClaimsFile:
    """Return the claims."""
    return parse_yaml(read_text(CLAIMS), ClaimsFile, str(CLAIMS))


def judge_claims(store: ResultStore, claims: Sequence[Claim]) -> list[Judged]:
    """Return the verdicts on claims. Raises FileError."""
    outcomes = [_TESTS[claim.test](store, **claim.arguments) for claim in claims]
    groups: dict[tuple[str, Test], list[int]] = {}
    for number, (claim, outcome) in enumerate(zip(claims, outcomes, strict=True)):
        if outcome.p is not None:
            groups.setdefault((claim.where, claim.test), []).append(number)
    for numbers in groups.values():
        corrected = holm([p for number in numbers if (p := outcomes[number].p) is not None])
        for number, p in zip(numbers, corrected, strict=True):
            outcomes[number] = replace(outcomes[number], p=p)
    return [_judged(claim, outcome) for claim, outcome in zip(claims, outcomes, strict=True)]


def _judged(claim: Claim, outcome: Outcome) -> Judged:
    verdict, why = Verdict.INCONCLUSIVE, claim.why
    if not outcome.tested:
        verdict, why = Verdict.NOT_TESTED, claim.why or outcome.runs
    elif outcome.holds:
        verdict = Verdict.REPRODUCED
    elif outcome.p is None:
        verdict = Verdict.INCONCLUSIVE if outcome.significant is None else Verdict.DIFFERS
        why = outcome.runs if outcome.significant is None else claim.why
    elif outcome.p < LEVEL:
        verdict = Verdict.REPRODUCED if outcome.significant else Verdict.DIFFERS
    else:
        why = f"p = {outcome.p:.2g}, {outcome.runs}"
    data = claim.model_dump(include={"name", "words", "where"})
    return Judged(**data, verdict=verdict, figure=outcome.figure, why=why)


def too_few(count: int) -> Outcome:
    """Return the outcome of a test without enough runs."""
    return Outcome("", f"{count} of at least {MIN_RUNS} runs exist", tested=False)


def runs_of(store: ResultStore, task: str, agent: str, budget: str) -> list[Result]:
    """Return the finished runs of an agent on a task with a budget."""
    return store.results(task, agent, BudgetName(budget))


def rate(  # noqa: PLR0917
    store: ResultStore,
    task: str,
    hits: int,
    of: int,
    budget: str = "published",
    agent: str = "circuit",
    within: int | None = None,
) -> Outcome:
    """Compare a success rate with another one; ``within`` counts runs that succeed in so many iterations."""
    runs = runs_of(store, task, agent, budget)
    if len(runs) < MIN_RUNS:
        return too_few(len(runs))
    succeeded = [run.success for run in runs]
    if within is not None:
        values = [run.value_after(within) for run in runs]
        if any(each is None for each in values):
            return Outcome("", "the curves are not complete", tested=False)
        succeeded = [each is not None and each >= TASKS[task].success for each in values]
    found = fisher(sum(succeeded), len(runs), hits, of)
    low, high = wilson(sum(succeeded), len(runs))
    return Outcome(
        figure=f"{sum(succeeded)} of {len(runs)} ({low:.0%} to {high:.0%}) against {hits} of {of}",
        runs=f"n = {len(runs)} and {of}",
        p=found.p,
        holds=found.interval[0] > -RATE_MARGIN and found.interval[1] < RATE_MARGIN,
        significant=False,
    )


def value(  # noqa: PLR0917
    store: ResultStore,
    task: str,
    agent: str,
    mean: float,
    std: float,
    of: int = 10,
    rate: float | None = None,
    budget: str = "published",
) -> Outcome:
    """Compare mean and standard deviation of returns with the paper's, where ``rate`` of the runs succeed."""
    runs = runs_of(store, task, agent, budget)
    if len(runs) < MIN_RUNS:
        return too_few(len(runs))
    returns = [run.mean for run in runs]
    ours = Summary(float(np.mean(returns)), float(np.std(returns, ddof=1)), len(returns))
    found, margin = welch(ours, Summary(mean, std, of)), TASKS[task].margin
    return Outcome(
        figure=f"{mean_text(ours.mean, ours.std)} against {mean_text(mean, std)}",
        runs=f"n = {len(runs)} and {of}",
        p=found.p,
        holds=-margin < found.interval[0] and found.interval[1] < margin,
        significant=False,
    )


def compare(  # noqa: PLR0917
    store: ResultStore,
    task: str,
    other: str,
    budget: str = "published",
    other_budget: str | None = None,
    better: bool = False,
) -> Outcome:
    """Compare the circuit's returns with those of another agent: ``better``, or at least equal.

    Where all runs end at the return that is enough, their steps to success decide whether it is better.
    """
    pair = [runs_of(store, task, "circuit", budget), runs_of(store, task, other, other_budget or budget)]
    if min(map(len, pair)) < MIN_RUNS:
        return too_few(min(map(len, pair)))
    returns = [np.array([run.mean for run in runs]) for runs in pair]
    found, what, sign = measure(*returns), "return", 1.0
    if better and all(run.ended == "enough" for runs in pair for run in runs):
        steps = [[run.steps_to(TASKS[task].success) for run in runs] for runs in pair]
        if any(each is None for row in steps for each in row):
            return Outcome("", "all runs reach the limit, and their curves are not complete", tested=False)
        found, what, sign = measure(*(np.array(row, np.float64) for row in steps)), "steps", -1.0
    means = " against ".join(mean_text(float(row.mean())) for row in returns)
    return Outcome(
        figure=f"{means}; difference of {what} {found.text()}",
        runs=f"n = {len(pair[0])} and {len(pair[1])}",
        p=found.p,
        holds=not better and found.interval[0] > -TASKS[task].margin,
        significant=sign * found.difference > 0.0,
    )


def sign(store: ResultStore, source: str, destination: str, expected: str) -> Outcome:
    """Compare the sign of a contribution with the paper's, in circuits where all readings agree."""
    found = [readings(policy, drive, source, destination) for policy, drive in drives(store)]
    if len(found) < MIN_RUNS:
        return too_few(len(found))
    clear = [next(iter(signs)) for signs in found if len(signs) == 1]
    hits = sum(each == expected for each in clear)
    figure = f"{hits} of {len(clear)} circuits that have a sign, of {len(found)}"
    if len(clear) < MIN_RUNS:
        return Outcome(figure, f"no evidence: {len(clear)} of {len(found)} circuits have a sign")
    low, high = wilson(hits, len(clear))
    against = False if high < 0.5 else None
    return Outcome(figure, f"{low:.0%} to {high:.0%}, n = {len(clear)}", holds=low > 0.5, significant=against)


def fact(store: ResultStore, of: str, expected: Any, **arguments: Any) -> Outcome:
    """Compare a fact with the paper's."""
    found = FACTS[of](store, **arguments)
    if found is None:
        return too_few(0)
    figure = f"{found}" if found == expected else f"{found} against {expected}"
    return Outcome(figure, holds=found == expected, significant=False)


def none(_: ResultStore) -> Outcome:
    """Return the outcome of a claim without a test."""
    return Outcome("", tested=False)


_TESTS: dict[Test, Callable[..., Outcome]] = {
    Test.RATE: rate,
    Test.VALUE: value,
    Test.COMPARE: compare,
    Test.SIGN: sign,
    Test.FACT: fact,
    Test.NONE: none,
}
