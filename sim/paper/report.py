"""The report on the paper's claims, as Markdown: answers, tables, and what the circuits show."""

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from rover_ncp.core.files import read_text
from sim.paper import FAITHFUL, BudgetName
from sim.paper.agents import AGENTS, GRADIENTS, LIQUID
from sim.paper.claims import ClaimsFile, Judged, Verdict, summary
from sim.paper.command_results import Group
from sim.paper.interpretation import clear_signs, drives, readings, time_constants
from sim.paper.results import Result, ResultStore
from sim.paper.selection import grid
from sim.paper.statistics import improvement, interquartile_mean, mean_text, wilson
from sim.paper.tasks import TASKS

Row = tuple[str, ...]
LAYOUTS: dict[str, Row] = {
    "Table II": ("circuit", "random"),
    "Table III": ("circuit", *GRADIENTS),
    "Table IV": ("lstm", "mlp", "circuit", "random"),
}
"""Agents of the paper's tables, in their order."""
_COLUMNS = ("pendulum", "mountain-car", "half-cheetah")
_ROBOTS = {"harsh": "robots of `harsh`", "unseen": "robots of `full` on other courses"}
_TRIALS = 1000


def short_report(store: ResultStore, file: ClaimsFile, judged: Sequence[Judged]) -> str:
    """Return the generated part of the page. Raises FileError."""
    counts = Counter(claim.verdict for claim in judged)
    parts = [
        answers(file, judged),
        f"Of {len(judged)} claims: " + ", ".join(f"{counts[each]} {each}" for each in Verdict) + ".",
        *(f"**{name}**\n\n{paper_table(store, file, name)}" for name in LAYOUTS),
        f"**Interquartile means by the paper's own search**\n\n{iqm_table(store, FAITHFUL)}",
        f"**Definition 1**\n\n{sign_table(store, file)}",
        f"**Time constants of parking, s**\n\n{time_constant_table(store, file)}",
        f"**Since the paper: parking random robots**\n\n{robots_table(store)}",
        f"**The stored runs, by commit**\n\n{commits_table(store)}",
    ]
    return "\n\n".join(parts)


def long_report(store: ResultStore, judged: Sequence[Judged]) -> str:
    """Return the tables of all claims, of all interquartile means and of all runs. Raises FileError."""
    claims = [(claim.name, claim.words, claim.where, claim.text, claim.figure) for claim in judged]
    runs = [
        (
            str(row.budget),
            row.task,
            row.agent,
            f"{row.made} of {row.runs}",
            f"{row.cpu_s:.0f}",
            _counts(row.ended),
            _counts(row.commits),
        )
        for row in coverage(store)
    ]
    return "\n\n".join(
        [
            "## All claims",
            markdown([("name", "claim", "where", "verdict", "ours against the paper's"), *claims]),
            "## All interquartile means",
            iqm_table(store, (*FAITHFUL, BudgetName.DEFAULT)),
            "## Settings",
            settings_table(),
            "## All runs",
            markdown([("budget", "task", "agent", "runs", "core s", "ended by", "commits"), *runs]),
        ]
    )


def answers(file: ClaimsFile, judged: Sequence[Judged]) -> str:
    """Return the page's questions with the verdicts on their claims."""
    by_name = {claim.name: claim for claim in judged}
    rows: list[Row] = [("question", "answer: ours against the paper's")]
    for number, (question, names) in enumerate(file.questions.items(), start=1):
        parts = []
        for verdict in Verdict:
            claims = [by_name[name] for name in names if by_name[name].verdict is verdict]
            found = "; ".join(f"`{each.name}` {each.figure}{_reason(each)}" for each in claims)
            if verdict is Verdict.NOT_TESTED:
                reasons = ", ".join(dict.fromkeys(claim.why for claim in claims))
                found = ", ".join(f"`{each.name}`" for each in claims) + f" ({reasons})"
            if claims:
                parts.append(f"**{verdict}**: {found}")
        rows.append((f"{number}. {question}", ". ".join(parts)))
    return markdown(rows)


def _reason(claim: Judged) -> str:
    return f" ({claim.why})" if claim.verdict is Verdict.INCONCLUSIVE else ""


def paper_table(store: ResultStore, file: ClaimsFile, name: str) -> str:
    """Return one of Tables II to IV in the paper's layout, theirs beside ours."""
    claims = [claim for claim in file.claims if claim.test == "value"]
    claims.sort(key=lambda claim: claim.where == name)
    paper = {(claim.arguments["task"], claim.arguments["agent"]): claim.arguments for claim in claims}
    columns = [task for task in _COLUMNS if all((task, agent) in paper for agent in LAYOUTS[name])]
    titles = [TASKS[task].title for task in columns]
    rows: list[Row] = [("agent", *(cell for title in titles for cell in (f"{title}: paper", "ours")))]
    for agent in LAYOUTS[name]:
        cells = []
        for task in columns:
            given = paper[task, agent]
            share = f" ({given['rate']:.0%})" if "rate" in given else ""
            budget = BudgetName(given.get("budget", "published"))
            cells += [
                mean_text(given["mean"], given["std"]) + share,
                _score(store.results(task, agent, budget)),
            ]
        rows.append((agent, *cells))
    return markdown(rows)


def _score(runs: Sequence[Result]) -> str:
    if not runs:
        return "not tested"
    share = sum(run.success for run in runs) / len(runs)
    mean, std, _ = summary(runs)
    return f"{mean_text(mean, std)} ({share:.0%})"


def iqm_table(store: ResultStore, budgets: Sequence[BudgetName]) -> str:
    """Return interquartile means, and the probability that a run of the circuit is better."""
    rows: list[Row] = [
        ("search", "task", "agent", "runs", "successes", "interquartile mean (95 %)", "P(circuit better)")
    ]
    for budget in budgets:
        pairs: dict[str, list[Any]] = {}
        for task in TASKS:
            own = _returns(store, task, "circuit", budget)
            for agent in AGENTS:
                returns = _returns(store, task, agent, budget)
                if len(returns) < 2:
                    continue
                above = ""
                if agent != "circuit" and len(own) > 1:
                    pairs.setdefault(agent, []).append((own, returns))
                    above = improvement([(own, returns)]).text()
                successes = sum(run.success for run in store.results(task, agent, budget))
                iqm = interquartile_mean(returns).text()
                rows.append((budget, task, agent, str(len(returns)), str(successes), iqm, above))
        for agent, found in pairs.items():
            tasks = f"mean of {len(found)} tasks"
            rows.append((budget, tasks, agent, "", "", "", improvement(found).text()))
    return markdown(rows)


def _returns(store: ResultStore, task: str, agent: str, budget: BudgetName) -> Any:
    return np.array([run.mean for run in store.results(task, agent, budget)])


def sign_table(store: ResultStore, file: ClaimsFile) -> str:
    """Return, for each pair, the circuits in which all readings of Definition 1 give one sign."""
    rows: list[Row] = [("pair", "paper", "circuits with one sign", "readings of the best circuit")]
    for claim in file.claims:
        if claim.test != "sign":
            continue
        pair = claim.arguments["source"], claim.arguments["destination"]
        found = [readings(policy, drive, *pair) for policy, drive in drives(store)]
        clear = Counter(clear_signs(found))
        best = _counts(found[0]) if found else ""
        signs = f"{_counts(clear) or 'none'} of {len(found)}"
        rows.append((" → ".join(pair), claim.arguments["expected"], signs, best))
    return markdown(rows)


def time_constant_table(store: ResultStore, file: ClaimsFile) -> str:
    """Return the time constants of the best parking circuit beside the paper's."""
    ours = time_constants(store, "parking")
    [claim] = [claim for claim in file.claims if claim.name == "time-constants"]
    rows: list[Row] = [("neuron", "ours", "paper")]
    for neuron, (low, high) in claim.arguments["ranges"].items():
        found = "{:.3g} .. {:.3g}".format(*ours[neuron]) if ours else "not tested"
        rows.append((neuron, found, f"{low:.3g} .. {high:.3g}"))
    return markdown(rows)


def robots_table(store: ResultStore) -> str:
    """Return how often each agent parks random robots, one training of each."""
    rows: list[Row] = [("agent", *_ROBOTS.values())]
    for agent in ("circuit", *LIQUID):
        path = store.folder / "random-robots" / f"{agent}.json"
        if not path.is_file():
            continue
        stored = json.loads(read_text(path))
        hits = [round(stored[name]["success_rate"] * _TRIALS) for name in _ROBOTS]
        cells = ["{} of {} ({:.1%} to {:.1%})".format(hit, _TRIALS, *wilson(hit, _TRIALS)) for hit in hits]
        rows.append((agent, *cells))
    return markdown(rows)


def coverage(store: ResultStore) -> list[Group]:
    """Return each group of the grid: how many of its runs exist, and the commits that made them."""
    rows = []
    for budget in (*FAITHFUL, BudgetName.DEFAULT):
        for group in grid(budget):
            runs = store.results(group.task, group.agent, budget)
            commits = Counter(_short(run.made_with.get("commit", "unknown")) for run in runs)
            rows.append(
                Group(
                    budget=budget,
                    task=group.task,
                    agent=group.agent,
                    made=len(runs),
                    runs=group.runs,
                    commits=commits,
                    ended=Counter(run.ended for run in runs),
                    cpu_s=sum(run.cpu_s for run in runs),
                )
            )
    return rows


def commits_table(store: ResultStore) -> str:
    """Return how many runs each commit made, by budget and task."""
    found: dict[tuple[str, str], Counter[str]] = {}
    for group in coverage(store):
        found.setdefault((group.budget, group.task), Counter()).update(group.commits)
    rows: list[Row] = [("search", "task", "runs", "of commit")]
    rows += [(*key, str(commits.total()), _counts(commits)) for key, commits in found.items() if commits]
    return markdown(rows)


def settings_table() -> str:
    """Return the settings of the experiments, and their thresholds of success."""
    columns = ("task", "horizon", "iterations", "rollouts", "worst", "parameters", "success")
    rows: list[Row] = [(*columns, "margin of equality")]
    for task in TASKS.values():
        numbers = (task.horizon, *task.settings, task.policy(task.circuit()).layout().size)
        threshold = f"{task.success:g} ({task.threshold_from})"
        rows.append((task.name, *map(str, numbers), threshold, f"{task.margin:g}"))
    return markdown(rows)


def _short(commit: str) -> str:
    return commit[:8] + ("-dirty" if commit.endswith("-dirty") else "")


def _counts(found: Any) -> str:
    return ", ".join(f"{count} {key}" for key, count in sorted(found.items(), key=lambda item: -item[1]))


def markdown(rows: Sequence[Row]) -> str:
    """Return rows of texts, the first one the head, as a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])
