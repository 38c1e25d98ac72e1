"""The report on the paper's claims, as Markdown: answers, tables, and what the circuits show."""

from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from paper.claims import ClaimsFile, Judged, Verdict, clear_signs, drives, readings, time_constants
from paper.runs import grid
from paper.statistics import improvement, interquartile_mean, mean_text, summary
from paper.store import BudgetName, Result, ResultStore
from paper.tasks import AGENTS, GRADIENTS, PAPERS, TASKS, Vector
from rover_ncp.core.errors import FileError

Row = Sequence[object]
LAYOUTS = {
    "Table II": ("circuit", "random"),
    "Table III": ("circuit", *GRADIENTS),
    "Table IV": ("lstm", "mlp", "circuit", "random"),
}
"""Agents of the paper's tables, in their order."""
_BUDGETS = (BudgetName.PUBLISHED, BudgetName.ALGORITHM1, BudgetName.GRADIENTS)
_COLUMNS = ("pendulum", "mountain-car", "half-cheetah")


def short_report(store: ResultStore, file: ClaimsFile, judged: Sequence[Judged]) -> str:
    """Return the generated part of the page. Raises FileError."""
    parts = [
        summary_of(file, judged),
        answers(file, judged),
        *(f"**{name}**\n\n{paper_table(store, file, name)}" for name in LAYOUTS),
        f"**Interquartile means**\n\n{iqm_table(store, _BUDGETS[:1])}",
        f"**Definition 1**\n\n{sign_table(store, file)}",
        f"**Time constants of parking, s**\n\n{time_constant_table(store, file)}",
    ]
    return "\n\n".join(parts)


def long_report(store: ResultStore, judged: Sequence[Judged]) -> str:
    """Return all claims, the settings and the stored runs. Raises FileError."""
    claims: list[Row] = [("name", "where", "claim", "ours", "compared with", "verdict")]
    claims += [(claim.name, claim.where, *_cells(claim)) for claim in judged]
    parts = {
        "All claims": markdown(claims),
        "Interquartile means of all searches": iqm_table(store, _BUDGETS),
        "Settings and thresholds": settings_table(),
        "The stored runs": runs_table(store),
    }
    return "\n\n".join(f"**{name}**\n\n{table}" for name, table in parts.items())


def summary_of(file: ClaimsFile, judged: Sequence[Judged]) -> str:
    """Return how many claims have each verdict, among those that answer the page's questions and others."""
    answering = {name for names in file.questions.values() for name in names}
    found = Counter((claim.verdict, claim.name in answering) for claim in judged)
    rows = [("verdict", "claims below", "others, in `--long`")]
    return markdown([*rows, *((each, found[each, True], found[each, False]) for each in Verdict)])


def answers(file: ClaimsFile, judged: Sequence[Judged]) -> str:
    """Return the page's questions, each with the claims that answer it."""
    by_name = {claim.name: claim for claim in judged}
    rows: list[Row] = [("claim", "ours", "compared with", "verdict")]
    for number, (question, names) in enumerate(file.questions.items(), start=1):
        rows += [(f"**{number}. {question}**", "", "", ""), *(_cells(by_name[name]) for name in names)]
    return markdown(rows)


def _cells(claim: Judged) -> Row:
    reason = f" ({claim.why})" if claim.why else ""
    return claim.words, claim.figure, claim.against, f"{claim.verdict}{reason}"


def paper_table(store: ResultStore, file: ClaimsFile, name: str) -> str:
    """Return one of Tables II to IV in the paper's layout, theirs beside ours."""
    claims = sorted(file.of("value"), key=lambda claim: claim.where == name)
    paper = {(claim.arguments["task"], claim.arguments["agent"]): claim.arguments for claim in claims}
    columns = [task for task in _COLUMNS if all((task, agent) in paper for agent in LAYOUTS[name])]
    titles = [TASKS[task].title for task in columns]
    rows: list[Row] = [("agent", *(cell for title in titles for cell in (f"{title}: paper", "ours")))]
    for agent in LAYOUTS[name]:
        cells = []
        for task in columns:
            given = paper[task, agent]
            share = f" ({given['rate']:.0%})" if "rate" in given else ""
            ours = store.results(task, agent, given.get("budget", "published"))
            cells += [mean_text(given["mean"], given["std"]) + share, _score(ours)]
        rows.append((agent, *cells))
    return markdown(rows)


def _score(runs: Sequence[Result]) -> str:
    if not runs:
        return "not tested"
    mean, std, count = summary(np.array([run.mean for run in runs]))
    return f"{mean_text(mean, std)} ({sum(run.success for run in runs) / count:.0%})"


def iqm_table(store: ResultStore, budgets: Sequence[BudgetName]) -> str:
    """Return interquartile means, and the probability that a run of the circuit is better."""
    rows: list[Row] = [("task", "agent", "successes", "10⁶ steps", "interquartile mean", "P(circuit better)")]
    for budget in budgets:
        pairs: dict[str, list[tuple[Vector, Vector]]] = {}
        search = "" if budget is BudgetName.PUBLISHED else f" ({budget})"
        for task in TASKS:
            own = store.returns(task, "circuit", budget)
            for agent in AGENTS:
                runs, returns = store.results(task, agent, budget), store.returns(task, agent, budget)
                if len(returns) < 2:
                    continue
                above = ""
                if agent != "circuit" and len(own) > 1:
                    pairs.setdefault(agent, []).append((own, returns))
                    above = improvement([(own, returns)]).text()
                successes = f"{sum(run.success for run in runs)} of {len(runs)}"
                steps = f"{np.median([run.steps for run in runs]) / 1e6:.3g}"
                iqm = interquartile_mean(returns).text()
                rows.append((f"{task}{search}", agent, successes, steps, iqm, above))
        for agent, found in pairs.items():
            rows.append((f"mean of {len(found)} tasks{search}", agent, "", "", "", improvement(found).text()))
    return markdown(rows)


def sign_table(store: ResultStore, file: ClaimsFile) -> str:
    """Return, for each pair, the circuits in which all readings of Definition 1 give one sign."""
    rows: list[Row] = [("pair", "circuits with a clear sign")]
    for claim in file.of("sign"):
        pair = claim.arguments["source"], claim.arguments["destination"]
        found = [readings(policy, drive, *pair) for policy, drive in drives(store)]
        clear = _counts(Counter(clear_signs(found))) or "none"
        rows.append((" → ".join(pair), f"{clear} of {len(found)}"))
    return markdown(rows)


def time_constant_table(store: ResultStore, file: ClaimsFile) -> str:
    """Return the time constants of the best parking circuit beside the paper's."""
    ours = time_constants(store)
    [claim] = [claim for claim in file.claims if claim.name == "time-constants"]
    rows: list[Row] = [("neuron", "ours", "paper")]
    for neuron, (low, high) in claim.arguments["ranges"].items():
        found = "{:.3g} .. {:.3g}".format(*ours[neuron]) if ours else "not tested"
        rows.append((neuron, found, f"{low:.3g} .. {high:.3g}"))
    return markdown(rows)


def runs_table(store: ResultStore) -> str:
    """Return how many runs of each search and task exist, their mean CPU time, and their commits."""
    rows: list[Row] = [("search", "task", "runs", "core s a run", "of commit")]
    for budget in _BUDGETS:
        for task, groups in groupby(grid(budget), lambda group: group.task):
            made, agents = [], []
            for group in groups:
                runs = store.results(task, group.agent, budget)
                made += runs
                agents.append(f"{group.agent} {len(runs)} of {group.runs}")
            core_s = f"{np.mean([run.cpu_s for run in made]):.0f}" if made else ""
            commits = Counter(_short(run.made_with.get("commit", "unknown")) for run in made)
            rows.append((budget, task, ", ".join(agents), core_s, _counts(commits)))
    return markdown(rows)


def settings_table() -> str:
    """Return the settings of the experiments, and their thresholds of success."""
    columns = ("task", "horizon", "iterations", "rollouts", "worst", "parameters", "success")
    rows: list[Row] = [(*columns, "margin of equality")]
    for task in TASKS.values():
        numbers = (task.horizon, *task.settings, task.policy(task.circuit()).layout().size)
        rows.append((task.name, *numbers, f"{task.success:g} ({task.threshold_from})", f"{task.margin:g}"))
    return markdown(rows)


def _short(commit: str) -> str:
    return commit[:8] + ("-dirty" if commit.endswith("-dirty") else "")


def _counts(found: Any) -> str:
    return ", ".join(f"{count} {key}" for key, count in sorted(found.items(), key=lambda item: -item[1]))


def markdown(rows: Sequence[Row]) -> str:
    """Return rows, the first one the head, as a Markdown table."""
    lines = [f"| {' | '.join(map(str, row))} |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


_POINTS = 200
_PARKING_RETURNS = (-6.0, 0.3)
"""Returns shown for parking; agents with a lower one do not drive to the goal."""
_COLORS = dict(zip(PAPERS, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True))
_PANELS_A_ROW = 3


def draw_curves(store: ResultStore, path: Path) -> None:
    """Draw the learning curves of the published search, as in the paper's figure 4. Raises FileError."""
    from matplotlib.figure import Figure

    found = {
        name: {agent: runs for agent in PAPERS if (runs := store.results(name, agent, BudgetName.PUBLISHED))}
        for name in TASKS
    }
    tasks = [TASKS[name] for name, agents in found.items() if agents]
    rows = max(-(-len(tasks) // _PANELS_A_ROW), 1)
    figure = Figure(figsize=(3.4 * _PANELS_A_ROW, 2.6 * rows), dpi=100, layout="constrained")
    panels: list[Any] = list(figure.subplots(rows, _PANELS_A_ROW, squeeze=False).flat)
    for axes, task in zip(panels, tasks, strict=False):
        for agent, runs in found[task.name].items():
            marks, middle, spread = average(runs)
            axes.fill_between(
                marks, middle - spread, middle + spread, color=_COLORS[agent], alpha=0.15, linewidth=0
            )
            axes.plot(marks, middle, color=_COLORS[agent], linewidth=1.5, label=f"{agent} ({len(runs)})")
        axes.axhline(task.success, color="0.6", linewidth=0.8, linestyle=":")
        if task.success < 0:
            axes.set_ylim(_PARKING_RETURNS)
        axes.set_title(task.title, fontsize=8)
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    for axes in panels[len(tasks) :]:
        axes.set_visible(False)
    figure.supxlabel("iterations", fontsize=9)
    figure.supylabel("estimated return of the best so far", fontsize=9)
    try:
        figure.savefig(path, format="png", metadata={"Software": None})
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def average(runs: Sequence[Result]) -> tuple[Any, Any, Any]:
    """Return iterations (n,), and mean and standard deviation (n,) of the estimates of all runs."""
    curves = [np.array([(point[0], point[2]) for point in run.curve], np.float64) for run in runs]
    marks = np.geomspace(1.0, max(2, *(run.settings["iterations"] for run in runs)), _POINTS)
    # Before a run's first estimate, that one counts.
    rows = [
        curve[np.maximum(np.searchsorted(curve[:, 0], marks, side="right") - 1, 0), 1] for curve in curves
    ]
    return marks, np.mean(rows, axis=0), np.std(rows, axis=0, ddof=min(len(rows) - 1, 1))
