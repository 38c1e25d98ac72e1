"""Claims about the values of Tables II to IV, each against the stored runs."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sim.paper import BudgetName
from sim.paper.agents import GRADIENTS
from sim.paper.claims import ENOUGH_RUNS, Claim, Finding, budget_option, too_few
from sim.paper.results import Result, ResultStore
from sim.paper.statistics import LEVEL, NO_GAP, Summary, mean_text, welch
from sim.paper.tables import TABLES, Row, Verdict, corrected, published_value, table
from sim.paper.tasks import TASKS

_UNEXPLAINED = {
    "pendulum": "failures lower a mean, but 90 % of the runs at 1168.5 and the others at 0 give 1051.7, so "
    "that 866.4 remains unexplained",
    "half-cheetah": "failures cannot raise 2587.4 to 2891.4, so that both values remain unexplained",
}
"""What failed attempts leave open in the two values of a task."""


def value_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield all claims about values of Tables II to IV."""
    yield from _cell_claims(store)
    yield from two_values(store)


def _cell_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield each value of Tables II to IV; the verdict is on the difference of ours.

    The paper's own search has the last word where at least three runs of it exist. Holm's correction is for
    the values of a table; a value that stands in two tables gets the larger p of the two.
    """
    cells = [(which, *cell) for which in TABLES for cell in _cells(which, store)]
    p_holm: dict[Any, float] = {}
    for _, row, _ in cells:
        p_holm[_value(row)] = max(p_holm.get(_value(row), 0.0), row.p_holm or 0.0)
    for which, cell, budget in cells:
        row = replace(cell, p_holm=p_holm[_value(cell)])
        if row.published is None:
            continue
        same_search = budget is BudgetName.PUBLISHED or row.agent in GRADIENTS
        verdict, why = _cell_verdict(row, same_search)
        yield Claim(
            name=f"{which}-{row.task}-{row.agent}",
            claim=f"{TASKS[row.task].title}, {row.agent}: {row.published.text()}",
            source=TABLES[which].number,
            verdict=verdict,
            figure=_ours(row),
            command=f"rover-ncp paper {which}{budget_option(budget)}",
            why=why,
        )


def _value(row: Row) -> tuple[Any, ...]:
    return row.task, row.agent, row.published


def _cells(which: str, store: ResultStore) -> list[tuple[Row, BudgetName]]:
    """Return the rows of a table and their budgets: the paper's own where enough runs of it exist."""
    own = {(row.task, row.agent): row for row in table(which, store, BudgetName.PUBLISHED)}
    cells = [
        (faithful, BudgetName.PUBLISHED)
        if (faithful := own.get((row.task, row.agent))) and faithful.runs >= ENOUGH_RUNS
        else (row, BudgetName.DEFAULT)
        for row in table(which, store)
    ]
    rows = corrected(row for row, _ in cells)
    return [(row, budget) for row, (_, budget) in zip(rows, cells, strict=True)]


def two_values(store: ResultStore) -> Iterator[Claim]:
    """Yield the experiments of which Tables II and IV give two values, with and without failures.

    All runs are compared with Table II, and those that succeeded with Table IV.
    """
    for task, unexplained in _UNEXPLAINED.items():
        published = [published_value(which, task, "circuit") for which in ("random-circuits", "networks")]
        runs, budget = _faithful_runs(store, task)
        succeeded = [result for result in runs if result.success]
        of_all, alone = (value for value in published if value is not None)
        claim = Claim(
            name=f"two-values-{task}",
            claim=f"{TASKS[task].title}: {of_all.text()} and {alone.text()} are of one experiment, "
            "with and without failed attempts",
            source="Tables II and IV",
            figure=f"{len(succeeded)} of {len(runs)} runs succeed",
            command="rover-ncp paper random-circuits" + budget_option(budget),
        )
        if len(runs) < ENOUGH_RUNS:
            yield too_few(store, task, budget, claim)
            continue
        if len(succeeded) in (0, 1, len(runs)):
            why = f"no two values arise where all runs succeed or fail; {unexplained}"
            yield replace(claim, verdict=Finding.NOT_REPRODUCED, why=why)
            continue
        assert alone.success_rate is not None
        # Without failures, the paper's value is of the runs that succeeded.
        theirs = of_all, alone._replace(runs=round(alone.success_rate * alone.runs))
        tests, figures = [], []
        for words, results, value in zip(
            ("all", "the successes alone"), (runs, succeeded), theirs, strict=True
        ):
            returns = [result.mean for result in results]
            ours = Summary(float(np.mean(returns)), float(np.std(returns, ddof=1)), len(returns))
            tests.append(welch(ours, value.summary()))
            figures.append(f"{words} {mean_text(ours.mean, ours.std)}, {tests[-1].sentence()}")
        apart = any(test.p < LEVEL for test in tests)
        yield replace(
            claim,
            verdict=Finding.NOT_REPRODUCED if apart else Finding.DIFFERENCE,
            figure="; ".join([claim.figure, *figures]),
            why=f"{'ours are others' if apart else NO_GAP}; {unexplained}",
        )


def _faithful_runs(store: ResultStore, task: str) -> tuple[list[Result], BudgetName]:
    """Return the circuit's runs by the paper's own search where at least three exist, or those by ours."""
    runs = store.results(task, "circuit", BudgetName.PUBLISHED)
    if len(runs) >= ENOUGH_RUNS:
        return runs, BudgetName.PUBLISHED
    return store.results(task, "circuit"), BudgetName.DEFAULT


def _cell_verdict(row: Row, same_search: bool) -> tuple[Finding, str]:
    """Return the verdict on one of the paper's values, and its reason."""
    if row.verdict is None:
        return Finding.NOT_TESTED, "fewer than two runs"
    search = "" if same_search else "with our search, "
    if row.verdict is not Verdict.EQUAL:
        return Finding.NOT_REPRODUCED, f"{search}ours is {row.verdict}"
    return Finding.DIFFERENCE, f"{search}{NO_GAP}"


def _ours(row: Row) -> str:
    if row.welch is None:
        return f"{row.runs} runs"
    values = f"{mean_text(row.mean, row.std)} ({row.success_rate:.0%})"
    return f"{values}; {row.welch.sentence()}, by Holm {row.p_holm:.2g}"
