"""Every claim, table, figure and supplement section of the paper, and whether it holds here.

Figures come from the stored runs, from the circuit itself or from drives of the trained parking circuits; a
verdict that depends on them is computed too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import median

import numpy as np

from sim.paper import BudgetName
from sim.paper.comparison import OTHERS, compare_agents
from sim.paper.results import Result, ResultStore
from sim.paper.statistics import LEVEL, NO_GAP, fisher, mean_text, measure
from sim.paper.tasks import TASKS

FAST = 5000
"""Iterations within which the paper's parking converges."""
ENOUGH_RUNS = 3
_SUCCEEDED = {"pendulum": 12, "mountain-car": 3, "cart-pole": 5}
_AGENTS = 12
"""Agents of an experiment in the supplement, of which so many succeed: 100 %, 25 % and 42 %."""
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
    verdict: Finding = Finding.NOT_TESTED
    figure: str = ""
    command: str = ""
    why: str = ""
    """The reason, where nothing was tested, or the difference."""


def all_claims(store: ResultStore) -> list[Claim]:
    """Return all claims. Raises FileError, and UsageError without a trained parking circuit."""
    from sim.paper.circuit_claims import circuit_claims  # drives the parking circuits
    from sim.paper.successors import successor_claims
    from sim.paper.value_claims import value_claims

    return [
        *_search_claims(store),
        *value_claims(store),
        *_comparison_claims(store, BudgetName.DEFAULT),
        *_comparison_claims(store, BudgetName.PUBLISHED),
        *successor_claims(),
        *circuit_claims(store),
        *_ELSEWHERE,
    ]


_COMPARED = {
    "random": ("Table II", "the tap-withdrawal circuit is better than random circuits of its size"),
    "mlp": ("Table IV", "the circuit is on par with an MLP or better"),
    "lstm": ("Table IV", "the circuit is on par with an LSTM or better"),
    "cfc": ("since the paper", "the circuit is on par with a CfC of about as many numbers or better"),
    "ltc": ("since the paper", "the circuit is on par with an LTC of about as many numbers or better"),
    "ppo": ("Table III", "the circuit with random search is on par with PPO"),
    "a2c": ("Table III", "the circuit with random search is on par with A2C"),
}


_LIMIT = "both agents reach the limit at which a search ends, so that their returns are not compared"


def budget_option(budget: BudgetName) -> str:
    """Return how a command names a budget, after a space, or nothing for the default one."""
    return "" if budget is BudgetName.DEFAULT else f" --budget {budget}"


def _comparison_claims(store: ResultStore, budget: BudgetName) -> Iterator[Claim]:
    """Yield the claim on each agent and task: better than random wirings, not worse than anything else."""
    own = budget is BudgetName.DEFAULT
    prefix, by = ("", "") if own else (f"{budget}-", "by the paper's own search, ")
    for row in (row for other in OTHERS for row in compare_agents(store, other, budget)):
        other = row.other
        number, words = _COMPARED[other]
        verdict, why = Finding.NOT_REPRODUCED, ""
        if row.at_limit and (row.better or other != "random"):
            verdict, why = Finding.DIFFERENCE, f"{_LIMIT}; steps to success: {row.verdict}"
        elif row.better:
            verdict = Finding.REPRODUCED
        elif other != "random" and not row.worse:
            verdict, why = Finding.DIFFERENCE, NO_GAP
        yield Claim(
            name=f"{prefix}{other}-{row.task}",
            claim=f"{TASKS[row.task].title}: {by}{words}",
            source=number if row.task in _PAPER_TASKS else f"{number}, on a task of ours",
            verdict=verdict,
            figure=row.sentence(),
            command=f"rover-ncp paper comparisons --agent {other}{budget_option(budget)}",
            why=why,
        )


def value_after(result: Result, iterations: int) -> float:
    """Return the estimate of the incumbent after so many iterations of one of the paper's own searches."""
    return [value for iteration, value in result.curve if iteration <= iterations][-1]


def _search_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield what the paper says of its search, from runs of the faithful columns alone."""
    from scipy.stats import binomtest

    names = {
        BudgetName.PUBLISHED: "the search of the published code trains the circuit to park",
        BudgetName.ALGORITHM1: "Algorithm 1 trains the circuit to park",
    }
    for budget, words in names.items():
        runs = store.results("parking", "circuit", budget)
        command = f"rover-ncp paper run --budget {budget} --task parking"
        source = "Algorithm 1" if budget is BudgetName.ALGORITHM1 else "published code"
        if len(runs) < ENOUGH_RUNS:
            yield too_few(store, "parking", budget, Claim(f"{budget}-parking", words, source))
            continue
        passed = [result.mean >= TASKS["parking"].success for result in runs]
        low, high = binomtest(sum(passed), len(runs)).proportion_ci(method="wilson")
        values = [result.mean for result in runs]
        figure = (
            f"{sum(passed)} of {len(runs)} pass -0.1 (Wilson {low:.0%} to {high:.0%}), median "
            f"{median(values):.3f}, best {max(values):.3f}"
        )
        hits, of = _PUBLISHED_CODE
        rates = fisher(sum(passed), len(runs), hits, of)
        yield Claim(
            f"{budget}-parking",
            words,
            source,
            share_finding(sum(passed), len(runs)),
            f"{figure}; the published code itself {hits} of {of}, rate {rates.sentence()}",
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


def too_few(store: ResultStore, task: str, budget: BudgetName, claim: Claim) -> Claim:
    """Return a claim that too few runs came to their end for."""
    figure = f"{len(store.results(task, 'circuit', budget))} runs came to their end"
    why = "the command makes the runs"
    command = f"rover-ncp paper run --budget {budget} --task {task}"
    return replace(claim, verdict=Finding.NOT_TESTED, figure=figure, command=command, why=why)


def _estimate_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield what rests on the faithful columns of the other tasks."""
    from scipy.stats import binomtest

    for task in (*_PAPER_TASKS, "cart-pole"):
        runs = store.results(task, "circuit", BudgetName.PUBLISHED)
        name, words = f"published-{task}", f"{TASKS[task].title}: the paper's own search trains the circuit"
        source, theirs = "Tables II to IV", _SUCCEEDED.get(task)
        if theirs is not None:
            words += f"; {theirs} of {_AGENTS} agents succeed"
            source = "supplement 5.2, success rates"
        if len(runs) < ENOUGH_RUNS:
            yield too_few(store, task, BudgetName.PUBLISHED, Claim(name, words, source))
            continue
        hits = sum(result.success for result in runs)
        low, high = binomtest(hits, len(runs)).proportion_ci(method="wilson")
        verdict, why = share_finding(hits, len(runs)), ""
        figure = f"{hits} of {len(runs)} succeed (Wilson {low:.0%} to {high:.0%})"
        if theirs is not None:
            rates = fisher(hits, len(runs), theirs, _AGENTS)
            figure += f"; against the paper's {theirs} of {_AGENTS}, rate {rates.sentence()}"
            verdict, why = Finding.DIFFERENCE, NO_GAP
            if rates.p < LEVEL:
                higher = "higher" if rates.difference > 0.0 else "lower"
                verdict, why = Finding.NOT_REPRODUCED, f"the rate is {higher} here"
        command = f"rover-ncp paper run --budget published --task {task}"
        yield Claim(name, words, source, verdict, figure, command, why)
    yield from _objective_claims(store)


def _objective_claims(store: ResultStore) -> Iterator[Claim]:
    """Yield the comparison of the two estimates, on the tasks where they differ."""
    source = "section on the objective"
    budgets = (BudgetName.PUBLISHED, BudgetName.PUBLISHED_MEAN)
    for task in TASKS.values():
        name, (_, rollouts, worst) = f"mean-or-worst-{task.name}", task.settings
        if worst == rollouts:
            chance = "an episode has no chance" if rollouts == 1 else "all rollouts are the worst ones"
            yield Claim(
                name,
                f"{task.title}: the mean of the worst k of N rollouts is the mean of all N",
                "Table S4",
                Finding.REPRODUCED,
                f"k = N = {rollouts}: {chance}, and both budgets make the same run",
                "rover-ncp paper parameters",
            )
            continue
        if task.name not in (*_PAPER_TASKS, "cart-pole"):
            continue
        words = f"{task.title}: the mean of the worst k rollouts is a better objective than the mean of all N"
        of_worst, of_all = (
            [result.mean for result in store.results(task.name, "circuit", budget)] for budget in budgets
        )
        if min(len(of_worst), len(of_all)) < ENOUGH_RUNS:
            fewer = budgets[len(of_all) < ENOUGH_RUNS]
            yield too_few(store, task.name, fewer, Claim(name, words, source))
            continue
        effect = measure(np.array(of_worst), np.array(of_all))
        better = effect.p < LEVEL and effect.difference > 0.0
        figure = (
            f"{mean_text(median(of_worst))} against {mean_text(median(of_all))} (medians); "
            + effect.sentence(len(of_worst), len(of_all))
        )
        yield Claim(
            name,
            words,
            source,
            Finding.REPRODUCED if better else Finding.NOT_REPRODUCED,
            figure,
            f"rover-ncp paper run --budget published-mean --task {task.name}",
        )


_ELSEWHERE = (
    Claim(
        "solver-cost",
        "a step's cost grows linearly with neurons and synapses",
        "supplement 3, solver",
        Finding.REPRODUCED,
        "9.9 µs of a tick, 0.060 µs a neuron and 0.027 µs a synapse; 16 circuits of 24 to 192 neurons and 60 "
        "to 480 synapses are at most 8 % off",
        "python -m benchmarks.circuit",
    ),
    Claim(
        "published-circuit-mountain-car",
        "the published circuit solves mountain car",
        "published code",
        Finding.DIFFERENCE,
        "94.3 in 100 episodes, 95 of them past 90, with position ±1; -0.8 with ±0.3 and -1.0 with Table S6's "
        "ranges, none past 90",
        "rover-ncp eval FILE.bnn --task mountain-car",
        "only with a range that the published code has in a comment; its files are not part of this project",
    ),
    Claim(
        "published-circuit-pendulum",
        "the published circuit balances the inverted pendulum",
        "published code",
        Finding.NOT_REPRODUCED,
        "0 of 100 episodes succeed: 310 of 1000 steps on Roboschool's step and start, 67 on Gymnasium's",
        "rover-ncp eval FILE.bnn --task roboschool",
        "it was trained on Roboschool's plant; ours is MuJoCo's, with Roboschool's step and start",
    ),
    Claim(
        "published-circuit-half-cheetah",
        "the published circuit runs as a half-cheetah",
        "published code",
        Finding.NOT_TESTED,
        "0 episodes: it takes an observation in place of its layer's second output",
        "rover-ncp eval FILE.bnn --task half-cheetah",
        "a circuit file has no layers",
    ),
    Claim(
        "rllab",
        "5 of 12 circuits solve rllab's mountain car",
        "supplement 5.2, Tables S3, S4 and S6",
        Finding.NOT_TESTED,
        "0 runs: rllab's car is a box of 0.4 kg on a chain of 200 edges in Box2D, pushed by 1 N and rewarded "
        "for its height; Gymnasium's is a point that moves by a formula",
        "rover-ncp paper run --task mountain-car",
        "contacts of another physics engine decide its motion",
    ),
    Claim(
        "rover",
        "a circuit trained in simulation parks a real rover",
        "section on parking, Table S1",
        Finding.NOT_TESTED,
        "0 drives of a real Pioneer; the mock speaks its protocol",
        "rover-ncp park",
        "no real rover was available",
    ),
    Claim(
        "videos",
        "five videos show the agents",
        "Table S1",
        Finding.NOT_TESTED,
        "0 videos compared: they state no value; pictures of our drives are in docs/interpretation",
        "rover-ncp explain parking --out docs/interpretation",
        "a video has no figure to compare",
    ),
)
"""Claims whose figures were measured by another command, or by none."""


def claims_text(found: Sequence[Claim]) -> str:
    """Return claims as Markdown, its columns as narrow as they are."""
    lines = ["| name | claim | source | verdict | figure | command |", "|---|---|---|---|---|---|"]
    for claim in found:
        verdict = f"{claim.verdict}: {claim.why}" if claim.why else claim.verdict
        cells = (claim.name, claim.claim, claim.source, verdict, claim.figure, f"`{claim.command}`")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)
