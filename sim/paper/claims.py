"""Every claim, table, figure and supplement section of the paper, and whether it holds here.

Figures come from the stored runs, from the circuit itself or from drives of the trained parking circuits; a
verdict that depends on them is computed too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import median

import numpy as np

from sim.paper import BudgetName
from sim.paper.agents import GRADIENTS
from sim.paper.comparison import OTHERS, Comparison, compare_agents, measure
from sim.paper.results import Result, ResultStore
from sim.paper.tables import LEVEL, TABLES, Row, Verdict, mean_text, table
from sim.paper.tasks import TASKS

FAST = 5000
"""Iterations within which the paper's parking converges."""
_ENOUGH_RUNS = 3
_RATES = {"mountain-car": 0.25, "cart-pole": 0.42}
"""Share of the supplement's agents that succeed."""
_PAPER_TASKS = ("pendulum", "mountain-car", "half-cheetah")
_PUBLISHED_CODE = (15, 48)
"""Runs of the published code itself that passed -0.1, measured with 48 seeds of 20,000 iterations."""


class Finding(StrEnum):
    """What a claim came to."""

    REPRODUCED = "reproduced"
    DIFFERENCE = "reproduced with a difference"
    NOT_REPRODUCED = "not reproduced"
    NOT_TESTED = "not tested"


@dataclass(frozen=True)
class Claim:
    """One row of the checklist."""

    name: str
    """Short, for citations."""
    claim: str
    source: str
    verdict: Finding
    figure: str
    command: str
    why: str = ""
    """The reason, where nothing was tested, or the difference."""


def all_claims(store: ResultStore) -> list[Claim]:
    """Return all claims. Raises FileError, and UsageError without a trained parking circuit."""
    from sim.paper.circuit_claims import circuit_claims  # drives the parking circuits

    return [
        *_search_claims(store),
        *_cell_claims(store),
        *_two_values(store),
        *(claim for other in OTHERS for claim in _comparison_claims(other, compare_agents(store, other))),
        *circuit_claims(store),
        *_untested(),
    ]


def _cell_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield each value of Tables II to IV, which is reproduced where ours is equal within noise.

    The paper's own search has the last word where at least three runs of it exist.
    """
    for which, named in TABLES.items():
        own = {(row.task, row.agent): row for row in table(which, store, BudgetName.PUBLISHED)}
        for default in table(which, store):
            faithful = own.get((default.task, default.agent))
            with_theirs = faithful is not None and faithful.runs >= _ENOUGH_RUNS
            row = faithful if with_theirs and faithful is not None else default
            if row.published is None:
                continue
            verdict, why = _cell_verdict(row, with_theirs or row.agent in GRADIENTS)
            yield Claim(
                name=f"{which}-{row.task}-{row.agent}",
                claim=f"{TASKS[row.task].title}, {row.agent}: {_published(row)}",
                source=named.number,
                verdict=verdict,
                figure=_ours(row),
                command=f"rover-ncp paper {which}" + (" --budget published" if with_theirs else ""),
                why=why,
            )


def _two_values(store: ResultStore) -> Iterator[Claim]:
    """Yield the experiments of which Tables II and IV give two values, with and without failures."""
    for task in _PAPER_TASKS:
        rows = [
            next(row for row in table(which, store) if (row.task, row.agent) == (task, "circuit"))
            for which in ("random-circuits", "networks")
        ]
        if rows[0].published == rows[1].published or rows[0].success_rate is None:
            continue
        failed = rows[0].success_rate < 1.0
        yield Claim(
            name=f"two-values-{task}",
            claim=f"{TASKS[task].title}: {' and '.join(map(_published, rows))} are of one experiment, "
            "with and without failed attempts",
            source="Tables II and IV",
            verdict=Finding.DIFFERENCE if failed else Finding.NOT_REPRODUCED,
            figure=_ours(rows[0]),
            command="rover-ncp paper random-circuits",
            why=""
            if failed
            else "none of the attempts of our default search failed, so that there is one value",
        )


def _cell_verdict(row: Row, same_search: bool) -> tuple[Finding, str]:
    """Return the verdict on one of the paper's values, and its reason."""
    if row.verdict is None:
        return Finding.NOT_TESTED, "fewer than two runs"
    search = "" if same_search else ", with our search"
    if row.verdict is not Verdict.EQUAL:
        return Finding.NOT_REPRODUCED, f"ours is {row.verdict}{search}"
    return (Finding.REPRODUCED, "") if same_search else (Finding.DIFFERENCE, f"equal within noise{search}")


def _published(row: Row) -> str:
    assert row.published is not None
    rate = row.published.success_rate
    return mean_text(row.published.mean, row.published.std) + ("" if rate is None else f" ({rate:.0%})")


def _ours(row: Row) -> str:
    if row.mean is None or row.p is None:
        return f"{row.runs} runs"
    return (
        f"{mean_text(row.mean, row.std)} ({row.success_rate:.0%}); Welch's test, n = {row.runs} and 10, "
        f"p = {row.p:.2g}"
    )


_COMPARED = {
    "random": ("random-circuits", "the tap-withdrawal circuit is better than random circuits of its size"),
    "mlp": ("networks", "the circuit is on par with an MLP or better"),
    "lstm": ("networks", "the circuit is on par with an LSTM or better"),
    "ppo": ("policy-gradients", "the circuit with random search is on par with PPO"),
    "a2c": ("policy-gradients", "the circuit with random search is on par with A2C"),
}


def _comparison_claims(other: str, found: Sequence[Comparison]) -> Iterator[Claim]:
    """Yield the claim on each task: better than random wirings, not worse than anything else."""
    which, words = _COMPARED[other]
    for row in found:
        verdict, why, number = Finding.NOT_REPRODUCED, "", TABLES[which].number
        if row.better:
            verdict = Finding.REPRODUCED
        elif other != "random" and not row.worse:
            verdict, why = Finding.DIFFERENCE, "no gap is found, which does not prove that there is none"
        yield Claim(
            name=f"{other}-{row.task}",
            claim=f"{TASKS[row.task].title}: {words}",
            source=number if row.task in _PAPER_TASKS else f"{number}, on a task of ours",
            verdict=verdict,
            figure=row.sentence(),
            command=f"rover-ncp paper comparisons --agent {other}",
            why=why,
        )


def value_after(result: Result, iterations: int) -> float:
    """Return the estimate of the incumbent after so many iterations of one of the paper's own searches."""
    return [value for iteration, value in result.curve if iteration <= iterations][-1]


def _search_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield what the paper says of its search, from runs of the faithful columns alone."""
    from scipy.stats import binomtest, fisher_exact

    names = {
        BudgetName.PUBLISHED: "the search of the published code trains the circuit to park",
        BudgetName.ALGORITHM1: "Algorithm 1 trains the circuit to park",
    }
    for budget, words in names.items():
        runs = store.results("parking", "circuit", budget)
        command = f"rover-ncp paper run --budget {budget} --task parking"
        source = "Algorithm 1" if budget is BudgetName.ALGORITHM1 else "published code"
        if not runs:
            yield _no_runs(f"{budget}-parking", words, source, command)
            continue
        passed = [result.mean >= TASKS["parking"].success for result in runs]
        low, high = binomtest(sum(passed), len(runs)).proportion_ci(method="wilson")
        values = [result.mean for result in runs]
        figure = (
            f"{sum(passed)} of {len(runs)} pass -0.1 (Wilson {low:.0%} to {high:.0%}), median "
            f"{median(values):.3f}, best {max(values):.3f}"
        )
        hits, of = _PUBLISHED_CODE
        p = float(fisher_exact([[sum(passed), len(runs) - sum(passed)], [hits, of - hits]]).pvalue)
        yield Claim(
            f"{budget}-parking",
            words,
            source,
            share_finding(sum(passed), len(runs)),
            f"{figure}; the published code itself {hits} of {of}, Fisher's test p = {p:.2g}",
            command,
            "most runs end in a local optimum" if not all(passed) else "",
        )
        fast = sum(value_after(result, FAST) >= TASKS["parking"].success for result in runs)
        yield Claim(
            f"{budget}-fast",
            f"parking converges in fewer than {FAST:,} iterations, and all agents succeed ({source})",
            "section on parking, learning-curve figure",
            share_finding(fast, len(runs)),
            f"{fast} of {len(runs)} pass -0.1 within {FAST:,} iterations, {sum(passed)} within 20,000",
            command,
        )
    yield from _estimate_claims(store)


def share_finding(hits: int, of: int) -> Finding:
    """Return the verdict on a claim of all that holds for some, here for most of them or for few."""
    if hits == of:
        return Finding.REPRODUCED
    return Finding.DIFFERENCE if 2 * hits > of else Finding.NOT_REPRODUCED


def _no_runs(name: str, claim: str, source: str, command: str) -> Claim:
    why = "no run of the paper's own search has come to its end; the command makes them"
    return Claim(name, claim, source, Finding.NOT_TESTED, "0 runs", command, why)


def _estimate_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield what rests on the faithful columns of the other tasks."""
    from scipy.stats import binomtest

    for task in (*_PAPER_TASKS, "cart-pole"):
        runs = store.results(task, "circuit", BudgetName.PUBLISHED)
        command = f"rover-ncp paper run --budget published --task {task}"
        words = f"{TASKS[task].title}: the paper's own search trains the circuit"
        if task in _RATES:
            words += f"; {_RATES[task]:.0%} of its agents succeed"
        source = "supplement, success rates" if task in _RATES else "Tables II to IV"
        if not runs:
            yield _no_runs(f"published-{task}", words, source, command)
            continue
        hits = sum(result.success for result in runs)
        low, high = binomtest(hits, len(runs)).proportion_ci(method="wilson")
        verdict, why = share_finding(hits, len(runs)), ""
        if task in _RATES:
            verdict, rate = Finding.REPRODUCED, _RATES[task]
            if not low <= rate <= high:
                verdict, why = (
                    Finding.NOT_REPRODUCED,
                    f"the rate is {'higher' if low > rate else 'lower'} here",
                )
        figure = f"{hits} of {len(runs)} succeed (Wilson {low:.0%} to {high:.0%})"
        yield Claim(f"published-{task}", words, source, verdict, figure, command, why)
    yield from _objective_claims(store)


def _objective_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield the comparison of the two estimates, on the tasks where they differ."""
    for task in TASKS.values():
        name = f"mean-or-worst-{task.name}"
        words = f"{task.title}: the mean of the worst k rollouts is a better objective than the mean of all N"
        command = f"rover-ncp paper run --budget published-mean --task {task.name}"
        source = "section on the objective"
        budgets = (BudgetName.PUBLISHED, BudgetName.PUBLISHED_MEAN)
        worst, mean = (
            [result.mean for result in store.results(task.name, "circuit", budget)] for budget in budgets
        )
        if task.settings.worst == task.settings.rollouts:
            why = f"k = N = {task.settings.rollouts}, so that both are the same"
            yield Claim(name, words, source, Finding.NOT_TESTED, "0 runs", command, why)
        elif min(len(worst), len(mean)) < _ENOUGH_RUNS:
            if task.name in (*_PAPER_TASKS, "cart-pole"):
                yield _no_runs(name, words, source, command)
        else:
            effect = measure(np.array(worst), np.array(mean))
            better = effect.p < LEVEL and effect.difference > 0.0
            verdict = Finding.REPRODUCED if better else Finding.NOT_REPRODUCED
            figure = (
                f"{mean_text(median(worst))} against {mean_text(median(mean))} (medians); "
                + effect.sentence(len(worst), len(mean))
            )
            yield Claim(name, words, source, verdict, figure, command)


_UNTESTED = (
    (
        "rllab",
        "the circuit solves rllab's mountain car",
        "Tables S3 and S6",
        "rover-ncp paper run --task mountain-car",
        "rllab's environment is not part of this project",
    ),
    (
        "published-circuits",
        "the published circuits earn the published returns",
        "published code",
        "rover-ncp eval FILE.bnn --task mountain-car",
        "they are under another licence and not part of this project",
    ),
    (
        "rover",
        "a circuit trained in simulation parks a real rover",
        "section on parking, videos",
        "rover-ncp park",
        "no real Pioneer was available; the mock speaks its protocol",
    ),
    (
        "videos",
        "videos show the agents",
        "supplement, videos",
        "rover-ncp park",
        "no video is compared",
    ),
    (
        "solver-cost",
        "a step's cost grows linearly with neurons and synapses",
        "supplement, solver",
        "rover-ncp bench deploy",
        "times were not measured against size",
    ),
    (
        "table-s4",
        "values of Table S4",
        "Table S4",
        "rover-ncp paper parameters",
        "the project holds no transcription of it",
    ),
)


def _untested() -> Iterator[Claim]:
    """Yield what nothing here tests."""
    for name, claim, source, command, why in _UNTESTED:
        yield Claim(name, claim, source, Finding.NOT_TESTED, "none", command, why)


def claims_text(found: Sequence[Claim]) -> str:
    """Return claims as Markdown, its columns as narrow as they are."""
    lines = ["| name | claim | source | verdict | figure | command |", "|---|---|---|---|---|---|"]
    for claim in found:
        verdict = f"{claim.verdict}: {claim.why}" if claim.why else claim.verdict
        cells = (claim.name, claim.claim, claim.source, verdict, claim.figure, f"`{claim.command}`")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
