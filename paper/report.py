"""The report on the paper's claims, as Markdown: answers, tables, and what the circuits show."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from paper.claims import (
    CLAIMS,
    FILE,
    MIN_RUNS,
    Finding,
    Verdict,
    by_pair,
    clear_signs,
    drives,
    judge_claims,
    signs,
    time_constants,
)
from paper.statistics import mean_interval, mean_text
from paper.store import BudgetName, Result, ResultStore
from paper.tasks import GRID, TASKS

Row = Sequence[object]


def short_report(store: ResultStore) -> str:
    """Return the generated part of the page. Raises FileError."""
    parts = [
        answers(judge_claims(store)),
        *(f"**{name}**\n\n{paper_table(store, name)}" for name in FILE.tables),
    ]
    if runs := store.results("half-cheetah", "circuit"):
        best = max(runs, key=lambda run: run.mean)
        parts.append(
            f"**Half-cheetah: which neuron drives which joints, best circuit**\n\n{wires_table(best)}"
        )
    ppo = "; ".join(f"{value} ({source})" for value, source in FILE.literature)
    parts += [f"**Half-cheetah by PPO**, from the literature: {ppo}.", commits(store)]
    return "\n\n".join(parts)


def long_report(store: ResultStore) -> str:
    """Return the stored runs and the tables behind the claims. Raises FileError."""
    main, clear = sign_tables(store)
    parts = {
        "The stored runs": runs_table(store),
        "Algorithm 1: parking": settings_grid(store, "parking"),
        "Algorithm 1: inverted pendulum": settings_grid(store, "pendulum"),
        "Definition 1: signs over the whole run, P > 1.5 Q": main,
        "Definition 1: circuits whose sign is the same in all twelve readings": clear,
        "Time constants of parking, s": time_constant_table(store),
    }
    return "\n\n".join(f"**{name}**\n\n{table}" for name, table in parts.items())


def answers(judged: Sequence[Finding]) -> str:
    """Return the page's questions with their answers, then the claims one by one."""
    short: list[Row] = [("question", "answer")]
    rows: list[Row] = [("claim", "ours", "compared with", "verdict")]
    findings = iter(judged)
    for number, (question, claims) in enumerate(FILE.questions.items(), start=1):
        rows.append((f"**{number}. {question}**", "", "", ""))
        by_verdict: dict[str, list[str]] = {verdict: [] for verdict in Verdict}
        for claim, found in zip(claims, findings, strict=False):
            verdict = str(found.verdict) + (f" ({found.why})" if found.why else "")
            rows.append((claim.words, found.figure, found.against, verdict))
            figure = found.figure and f" ({found.figure.partition(' [')[0]})"
            by_verdict[str(found.verdict)].append((claim.label or claim.words) + figure)
        answer = (f"{verdict}: {', '.join(those)}" for verdict, those in by_verdict.items() if those)
        short.append((f"{number}. {question}", "; ".join(answer)))
    return f"{markdown(short)}\n\n{markdown(rows)}"


def paper_table(store: ResultStore, name: str) -> str:
    """Return one of Tables II to IV in the paper's layout, theirs beside ours."""
    tasks = FILE.tables[name]
    agents = next(iter(tasks.values()))
    titles = [TASKS[task].title for task in tasks]
    rows: list[Row] = [("agent", *(cell for title in titles for cell in (f"{title}: paper", "ours")))]
    for agent in agents:
        cells = []
        for task, given in tasks.items():
            mean, std, *rate = given[agent]
            share = f" ({rate[0]:.0%})" if rate else ""
            cells += [mean_text(mean, std) + share, _score(store.results(task, agent))]
        rows.append((agent, *cells))
    return markdown(rows)


def _score(runs: Sequence[Result]) -> str:
    if not runs:
        return "not tested"
    means = np.array([run.mean for run in runs])
    count, mean = len(runs), float(means.mean())
    value = mean_text(mean, float(means.std(ddof=1)) if count > 1 else None)
    share = f"{value} ({sum(run.success for run in runs) / count:.0%}"
    if count > MIN_RUNS:
        return f"{share})"
    between = "" if count == 1 else f"; mean {mean_interval(means).text()}"
    return f"{share}, {count} runs{between})"


def settings_grid(store: ResultStore, task: str) -> str:
    """Return successes, median and best return of Algorithm 1 for each alpha and first sigma."""
    pairs = by_pair(store.results(task, "circuit", BudgetName.ALGORITHM1))
    alphas, sigmas = (sorted({pair[at] for pair in pairs}) for at in (0, 1))
    rows: list[Row] = [("alpha", *(f"first sigma {sigma:.0%} of the range" for sigma in sigmas))]
    for alpha in alphas:
        cells = []
        for sigma in sigmas:
            runs = pairs.get((alpha, sigma), [])
            means = [run.mean for run in runs] or [math.nan]
            text = f"median {mean_text(float(np.median(means)))}, best {mean_text(max(means))}"
            hits = sum(run.success for run in runs)
            cells.append(f"{hits} of {len(runs)}, {text}" if runs else "not trained")
        rows.append((f"{alpha:g}", *cells))
    return markdown(rows)


def sign_tables(store: ResultStore) -> tuple[str, str]:
    """Return the signs of each pair in the parking circuits of both searches.

    The first table is by the main reading; the second counts the circuits in which all readings agree.
    """
    titles = ("published search", "default search, ours")
    main: list[Row] = [("pair", "paper", *titles)]
    clear: list[Row] = [("pair", *titles)]
    searches = [(budget, len(drives(store, budget))) for budget in (BudgetName.PUBLISHED, BudgetName.DEFAULT)]
    for claim in CLAIMS:
        if claim.test != "sign":
            continue
        pair = claim.arguments["source"], claim.arguments["destination"]
        found, agreed = (
            [f"{_counts(count(store, budget, *pair)) or 'none'} of {number}" for budget, number in searches]
            for count in (signs, clear_signs)
        )
        main.append((" → ".join(pair), claim.arguments["expected"], *found))
        clear.append((" → ".join(pair), *agreed))
    return markdown(main), markdown(clear)


def wires_table(run: Result) -> str:
    """Return the layers of a half-cheetah's circuit: what moves each joint, and what drives each sensor."""
    task = TASKS["half-cheetah"]
    policy = task.policy().with_parameters(run.parameters.array())
    assert policy.output_layer is not None
    assert policy.input_layer is not None
    neurons = [channel.positive for channel in policy.motors.channels]
    rows: list[Row] = [("joints", *(f"{neuron}: back, front" for neuron in neurons), "most torque by")]
    back, front = policy.output_layer[:3], policy.output_layer[3:]
    for joint, pair in zip(("thigh", "shin", "foot"), zip(back, front, strict=True), strict=True):
        cells = (f"{first:+.2f}, {second:+.2f}" for first, second in zip(*pair, strict=True))
        rows.append((joint, *cells, neurons[int(np.argmax(np.abs(pair).sum(axis=0)))]))
    senses, names = [], [name.replace("_", " ") for name in policy.sensing.inputs]
    for channel, weights in zip(policy.sensing.channels, policy.input_layer, strict=True):
        most = ", ".join(f"{names[at]} {weights[at]:+.2f}" for at in np.argsort(-np.abs(weights))[:4])
        senses.append(f"{channel.positive} (+) and {channel.negative} (−): {most}")
    return f"{markdown(rows)}\n\nInputs of most weight: {'; '.join(senses)}."


def commits(store: ResultStore) -> str:
    """Return which commit made which runs."""
    made: dict[str, dict[str, None]] = {}
    for run in store.every():
        made.setdefault(_commit(run), {})[f"{run.name.budget} {run.name.task}"] = None
    most, *others = sorted(made, key=lambda commit: -len(made[commit]))
    rest = "".join(f"; {', '.join(made[commit])}: {commit}" for commit in others)
    return f"**Commits of the runs**: {most}{rest}."


def time_constant_table(store: ResultStore) -> str:
    """Return the time constants of the best parking circuit beside the paper's."""
    ours = time_constants(store)
    [claim] = [claim for claim in CLAIMS if claim.test == "constants"]
    rows: list[Row] = [("neuron", "ours", "paper")]
    for neuron, (low, high) in claim.arguments["ranges"].items():
        found = "{:.3g} .. {:.3g}".format(*ours[neuron]) if ours else "not tested"
        rows.append((neuron, found, f"{low:.3g} .. {high:.3g}"))
    return markdown(rows)


def runs_table(store: ResultStore) -> str:
    """Return the stored runs of each search, task and agent."""
    columns = ("search", "task", "agent", "runs", "return", "10⁶ steps", "core s a run", "of commit")
    rows: list[Row] = [columns]
    for cell in GRID:
        for task, agent in product(cell.tasks, cell.agents):
            row: Row = (cell.budget, task, agent, 0, *[""] * 4)
            if runs := store.results(task, agent, cell.budget):
                commits = _counts(_commit(run) for run in runs)
                steps = f"{np.median([run.steps for run in runs]) / 1e6:.3g}"
                core_s = f"{np.mean([run.cpu_s for run in runs]):.0f}"
                row = (*row[:3], len(runs), _score(runs), steps, core_s, commits)
            rows.append(row)
    return markdown(rows)


def _commit(run: Result) -> str:
    commit = run.made_with.get("commit", "unknown")
    return commit[:8] + ("-dirty" if commit.endswith("-dirty") else "")


def _counts(items: Iterable[str]) -> str:
    return ", ".join(f"{count} {item}" for item, count in Counter(items).most_common())


def markdown(rows: Sequence[Row]) -> str:
    """Return rows, the first one the head, as a Markdown table."""
    lines = [f"| {' | '.join(map(str, row))} |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])
