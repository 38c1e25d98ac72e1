"""The paper's tables, from the runs that exist, as records and as Markdown.

Beside each row of ours stands the paper's, and a verdict: better or worse if Welch's t-test, on mean,
standard deviation and number of runs of both, finds a difference at the 5 % level, otherwise equal within
noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from sim.paper import BudgetName
from sim.paper.agents import GRADIENTS
from sim.paper.results import Result, ResultStore
from sim.paper.runs import budget_for
from sim.paper.selection import Group, grid
from sim.paper.tasks import TASKS

LEVEL = 0.05


class Table(NamedTuple):
    """One of the paper's tables."""

    number: str
    title: str
    agents: tuple[str, ...]


TABLES = {
    "random-circuits": Table("Table II", "the circuit and random circuits", ("circuit", "random")),
    "policy-gradients": Table("Table III", "the circuit and policy gradients", ("circuit", *GRADIENTS)),
    "networks": Table("Table IV", "networks and circuits", ("lstm", "mlp", "circuit", "random")),
}


class Published(NamedTuple):
    """Mean and standard deviation over the paper's runs, and the share that succeeded where it is given."""

    mean: float
    std: float
    success_rate: float | None = None


PUBLISHED_RUNS = 10
_MOTORS_MV = "-70 .. -20 (text), -60 .. -20 (code)"
_SENSORS_MV = "the same (text), not clamped (code)"
_PENDULUM = {
    "lstm": Published(629.0, 453.1, 0.4),
    "mlp": Published(1177.5, 31.8, 1.0),
    "circuit": Published(1168.5, 21.7, 0.9),
    "random": Published(138.1, 263.2, 0.1),
    "ppo": Published(1187.4, 51.7),
    "a2c": Published(1191.2, 45.2),
}
PUBLISHED = {
    # The paper's pendulum was Roboschool's; Gymnasium's is the task of today.
    "pendulum": _PENDULUM,
    "roboschool": _PENDULUM,
    "mountain-car": {
        "lstm": Published(97.5, 1.25, 1.0),
        "mlp": Published(95.9, 1.86, 1.0),
        "circuit": Published(91.5, 6.6, 0.8),
        "random": Published(54.0, 44.6, 0.5),
        "ppo": Published(94.6, 1.3),
        "a2c": Published(86.4, 18.3),
    },
    "half-cheetah": {
        "lstm": Published(1588.9, 353.8, 0.1),
        "mlp": Published(1271.8, 634.4, 0.0),
        "circuit": Published(2587.4, 846.8, 0.727),
        "random": Published(1743.0, 642.3, 0.5),
    },
}
_TABLE_II = {"pendulum": Published(866.4, 418.0), "half-cheetah": Published(2891.4, 1016.0)}
_TABLE_II["roboschool"] = _TABLE_II["pendulum"]
"""The circuit's values where Table II differs from Table IV: failed attempts are included."""
SPARSITY = {"lstm": 0.0, "mlp": 0.0, "circuit": 0.77, "random": 0.77}
"""Share of the possible connections that an agent does without."""


class Verdict(StrEnum):
    """Our runs against the paper's."""

    BETTER = "better"
    EQUAL = "equal within noise"
    WORSE = "worse"


@dataclass(frozen=True)
class Row:
    """The runs of a task and an agent."""

    task: str
    agent: str
    runs: int
    wanted: int
    mean: float | None
    std: float | None
    """Over runs, of a sample; None for fewer than two."""
    plain_mean: float | None
    success_rate: float | None
    cpu_s: float | None
    """Mean of a run."""
    published: Published | None
    verdict: Verdict | None
    p: float | None

    def fields(self) -> dict[str, Any]:
        """Return the row as ``--json`` prints it."""
        return vars(self) | {
            "published": self.published._asdict() | {"runs": PUBLISHED_RUNS} if self.published else None,
            #: share of the possible connections that the agent does without
            "sparsity": SPARSITY.get(self.agent),
            "test": "Welch",  #: behind verdict and p
        }

    def texts(self) -> tuple[str, ...]:
        """Return the row's cells as Markdown."""
        paper = self.published
        rate = "" if paper is None or paper.success_rate is None else f" ({paper.success_rate:.0%})"
        return (
            TASKS[self.task].title,
            self.agent,
            f"{self.runs} of {self.wanted}",
            mean_text(self.mean, self.std),
            "" if self.success_rate is None else f"{self.success_rate:.0%}",
            "" if paper is None else f"{paper.mean:.1f} ± {paper.std:.1f}{rate}",
            "" if self.verdict is None else f"{self.verdict} (p = {self.p:.2g})",
            "" if self.cpu_s is None else f"{self.cpu_s:.0f} s",
        )


def table(which: str, store: ResultStore, budget: BudgetName = BudgetName.DEFAULT) -> list[Row]:
    """Return a table's rows by task, including those without a run. Raises FileError."""
    order = TABLES[which].agents
    groups = grid(budget)
    tasks = {group.task for group in groups if group.agent == order[-1]}
    groups = tuple(group for group in groups if group.agent in order and group.task in tasks)
    by_task = sorted(groups, key=lambda group: (list(TASKS).index(group.task), order.index(group.agent)))
    return [make_row(group, group.results(store), published_value(which, group)) for group in by_task]


def published_value(which: str, group: Group) -> Published | None:
    """Return what one of the paper's tables says of a group, if it does."""
    if which == "random-circuits" and group.agent == "circuit" and group.task in _TABLE_II:
        return _TABLE_II[group.task]
    return PUBLISHED.get(group.task, {}).get(group.agent)


def make_row(group: Group, results: Sequence[Result], paper: Published | None) -> Row:
    """Return a row of a table."""
    judged = p = None
    mean = std = plain = success = cpu_s = None
    if results:
        mean, plain, success, cpu_s = (
            float(np.mean([getattr(result, field) for result in results]))
            for field in ("mean", "plain_mean", "success", "cpu_s")
        )
    if len(results) > 1 and mean is not None:
        std = float(np.std([result.mean for result in results], ddof=1))
        if paper is not None:
            judged, p = compare(mean, std, len(results), paper)
    return Row(
        group.task, group.agent, len(results), group.runs, mean, std, plain, success, cpu_s, paper, judged, p
    )


def compare(mean: float, std: float, runs: int, published: Published) -> tuple[Verdict, float]:
    """Return the verdict on our runs, and the probability of such a difference by chance."""
    from scipy.stats import ttest_ind_from_stats

    if std == 0.0 and published.std == 0.0:
        p = 1.0 if mean == published.mean else 0.0
    else:
        theirs = (published.mean, published.std, PUBLISHED_RUNS)
        p = float(ttest_ind_from_stats(mean, std, runs, *theirs, equal_var=False).pvalue)
    if p >= LEVEL:
        return Verdict.EQUAL, p
    return (Verdict.BETTER if mean > published.mean else Verdict.WORSE), p


def table_fields(which: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return a table as ``--json`` prints it."""
    return {"table": TABLES[which].number, "cells": [row.fields() for row in rows]}


def table_text(which: str, rows: Sequence[Row]) -> str:
    """Return a table as Markdown."""
    head = ("task", "agent", "runs", "ours", "success", "paper", "verdict", "core time")
    named = TABLES[which]
    return f"{named.number}: {named.title}\n\n" + markdown([head, *(row.texts() for row in rows)])


def coverage_text(groups: Sequence[dict[str, Any]]) -> str:
    """Return the groups of a budget as Markdown; runs of several commits were made at several times."""
    rows: list[tuple[str, ...]] = [("task", "agent", "runs", "core s a run", "ended by", "commits")]
    for group in groups:
        took = [group["cpu_s"] / group["made"]] if group["made"] else []
        took += [3600.0 * run["hours_to_run"] for run in group["unfinished"]]
        took += [3600.0 * run["hours_to_run"] for run in group["stopped"]]
        part = [f"seed {run['seed']} at {run['iterations']} of {run['of']}" for run in group["unfinished"]]
        part += [f"seed {run['seed']} {stopped_text(run)}" for run in group["stopped"]]
        rows.append(
            (
                group["task"],
                group["agent"],
                "; ".join([f"{group['made']} of {group['runs']}", *part]),
                f"{np.mean(took):.0f}" if took else "",
                _counts(group["ended"]),
                _counts({_short(commit): count for commit, count in group["commits"].items()}),
            )
        )
    return markdown(rows)


def stopped_text(run: dict[str, Any]) -> str:
    """Return the state of a run that was stopped."""
    return (
        f"stopped at {run['iterations']:,} of {run['of']:,} iterations, estimate "
        f"{mean_text(run['estimate'])}: {run['why']}"
    )


def _short(commit: str) -> str:
    return commit[:8] + ("-dirty" if commit.endswith("-dirty") else "")


def _counts(found: dict[str, int]) -> str:
    return ", ".join(key if len(found) == 1 else f"{count} {key}" for key, count in found.items())


def parameters() -> list[dict[str, Any]]:
    """Return the experiments' parameters: the paper's, and the limits of a run with the default budget."""
    rows = []
    for task in TASKS.values():
        policy = task.policy(task.circuit())
        ours = budget_for(task, BudgetName.DEFAULT)
        rows.append(
            {
                "task": task.name,
                "horizon": task.horizon,  #: in ticks
                "published_horizon": task.published_horizon or task.horizon,  #: the paper's
                "published_search": task.published_search,  #: the published code's
                **task.settings._asdict(),
                "success": task.success,  #: least mean return, without bonus
                "threshold_from": task.threshold_from,  #: who set it
                "default_steps": ours.steps,  #: at most, in a run with the default budget, as the starts
                "default_starts": ours.starts,  #: of a search, at most
                "neurons": policy.circuit.size,
                "synapses": policy.circuit.synapse_count,
                "parameters": policy.layout().size,
                "sensors": {channel.name: dict(channel.sides) for channel in policy.sensing.channels},
                "motors": {channel.name: dict(channel.sides) for channel in policy.motors.channels},
                "motor_range_mV": [policy.motors.low_mV, policy.motors.high_mV],  #: of a motor neuron
                "published_ranges": dict(task.published_ranges),  #: the paper's, where they are others
            }
        )
    return rows


def parameters_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the experiments' parameters and their mappings, beside the paper's, as Markdown."""
    keys = ("task", "horizon", "iterations", "rollouts", "worst", "parameters", "default_steps")
    settings: list[tuple[str, ...]] = [(*keys, "success")]
    mappings: list[tuple[str, ...]] = [("task", "signal", "neurons", "range", "the paper's")]
    for row in rows:
        threshold = f"{row['success']:g} ({row['threshold_from']})"
        cells = {key: str(row[key]) for key in keys}
        if row["published_horizon"] != row["horizon"]:
            cells["horizon"] += f" ({row['published_horizon']} in Table S4)"
        settings.append((*cells.values(), threshold))
        for name, sides in (row["sensors"] | row["motors"]).items():
            ends = _span(sorted({*sides.values(), *([0.0] if len(sides) == 1 else [])}))
            paper = row["published_ranges"].get(name, "the same")
            mappings.append((row["task"], name, ", ".join(sides), ends, paper))
    mappings.append(("all", "potential, mV", "sensory neurons", "-70 .. -20, clamped", _SENSORS_MV))
    mappings.append(("all", "potential, mV", "motor neurons", _span(rows[0]["motor_range_mV"]), _MOTORS_MV))
    return f"{markdown(settings)}\n\n{markdown(mappings)}"


def _span(ends: Sequence[float]) -> str:
    return f"{ends[0]:g} .. {ends[-1]:g}"


def markdown(rows: Sequence[tuple[str, ...]]) -> str:
    """Return rows of texts, the first one the head, as a Markdown table in even columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |"
        for row in rows
    ]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])


def mean_text(mean: float | None, std: float | None = None) -> str:
    """Return a mean, and its deviation, with the digits of its size."""
    if mean is None:
        return ""
    digits = 1 if abs(mean) >= 10 else 3
    spread = "" if std is None else f" ± {std:.{digits}f}"
    return f"{mean:.{digits}f}{spread}"
