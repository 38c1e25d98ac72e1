"""The paper's tables, from the runs that exist, as records and as Markdown.

Beside each row of ours stands the paper's, and a verdict: better or worse if Welch's t-test, on mean,
standard deviation and number of runs of both, finds a difference at the 5 % level after Holm's correction for
the number of values.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from sim.paper import BudgetName
from sim.paper.agents import GRADIENTS
from sim.paper.results import Result, ResultStore
from sim.paper.runs import budget_for
from sim.paper.selection import Group, grid
from sim.paper.statistics import LEVEL, Difference, Summary, holm, interval_text, mean_text, welch
from sim.paper.tasks import TASKS


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
    runs: int = 10
    """Our assumption. All success rates of the tables are shares of ten runs except half-cheetah's."""

    def text(self) -> str:
        """Return mean, deviation and rate in a line."""
        rate = "" if self.success_rate is None else f" ({self.success_rate:.1%})".replace(".0%", "%")
        return mean_text(self.mean, self.std) + rate

    def summary(self) -> Summary:
        """Return what a test compares."""
        return Summary(self.mean, self.std, self.runs)


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
        "circuit": Published(2587.4, 846.8, 0.727, 11),  # 8 of 11
        "random": Published(1743.0, 642.3, 0.5),
    },
}
_TABLE_II = {"pendulum": Published(866.4, 418.0), "half-cheetah": Published(2891.4, 1016.0, runs=11)}
_TABLE_II["roboschool"] = _TABLE_II["pendulum"]
"""The circuit's values where Table II differs from Table IV; as the paper says, with failed attempts."""
SPARSITY = {"lstm": 0.0, "mlp": 0.0, "circuit": 0.77, "random": 0.77}
"""Share of the possible connections that an agent does without."""


class Verdict(StrEnum):
    """Our runs against the paper's."""

    BETTER = "better"
    EQUAL = "no difference found"
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
    p_holm: float | None = None

    @property
    def welch(self) -> Difference | None:
        """Ours against the paper's, where there are two runs at least."""
        if self.mean is None or self.std is None or self.published is None:
            return None
        return welch(Summary(self.mean, self.std, self.runs), self.published.summary())

    @property
    def verdict(self) -> Verdict | None:
        """Whether ours are better or worse than the paper's beyond chance."""
        found = self.welch
        if found is None or self.p_holm is None:
            return None
        if self.p_holm >= LEVEL:
            return Verdict.EQUAL
        return Verdict.BETTER if found.difference > 0.0 else Verdict.WORSE

    def fields(self) -> dict[str, Any]:
        """Return the row as ``--json`` prints it."""
        found = self.welch
        return vars(self) | {
            "published": self.published._asdict() if self.published else None,
            "verdict": self.verdict,
            "difference": found and found.difference,  #: of ours and the paper's
            "interval": found and found.interval,  #: of the difference, 95 %
            "p": found and found.p,
            #: share of the possible connections that the agent does without
            "sparsity": SPARSITY.get(self.agent),
            "test": "Welch",  #: behind verdict and p
        }

    def texts(self) -> tuple[str, ...]:
        """Return the row's cells as Markdown."""
        found = self.welch
        return (
            TASKS[self.task].title,
            self.agent,
            f"{self.runs} of {self.wanted}",
            mean_text(self.mean, self.std),
            "" if self.success_rate is None else f"{self.success_rate:.0%}",
            "" if self.published is None else self.published.text(),
            "" if found is None else f"{mean_text(found.difference)} ({interval_text(found.interval)})",
            "" if found is None else f"{found.p:.2g}",
            "" if self.p_holm is None else f"{self.p_holm:.2g}",
            "" if self.verdict is None else str(self.verdict),
            "" if self.cpu_s is None else f"{self.cpu_s:.0f} s",
        )


def table(which: str, store: ResultStore, budget: BudgetName = BudgetName.DEFAULT) -> list[Row]:
    """Return a table's rows by task, including those without a run. Raises FileError."""
    order = TABLES[which].agents
    # Only the default grid has an agent of each column on all of a table's tasks.
    tasks = [group.task for group in grid() if group.agent == order[-1]]
    groups = [group for group in grid(budget) if group.agent in order and group.task in tasks]
    groups.sort(key=lambda group: (tasks.index(group.task), order.index(group.agent)))
    return corrected(
        make_row(group, group.results(store), published_value(which, group.task, group.agent))
        for group in groups
    )


def corrected(rows: Iterable[Row]) -> list[Row]:
    """Return the rows of a table with p corrected by Holm."""
    rows = list(rows)
    p_holm = iter(holm([row.welch.p for row in rows if row.welch]))
    return [replace(row, p_holm=next(p_holm)) if row.welch else row for row in rows]


def published_value(which: str, task: str, agent: str) -> Published | None:
    """Return what one of the paper's tables says of an agent on a task, if it does."""
    if which == "random-circuits" and agent == "circuit" and task in _TABLE_II:
        return _TABLE_II[task]
    return PUBLISHED.get(task, {}).get(agent)


def make_row(group: Group, results: Sequence[Result], paper: Published | None) -> Row:
    """Return a row of a table."""
    mean = std = plain = success = cpu_s = None
    if results:
        mean, plain, success, cpu_s = (
            float(np.mean([getattr(result, field) for result in results]))
            for field in ("mean", "plain_mean", "success", "cpu_s")
        )
    if len(results) > 1:
        std = float(np.std([result.mean for result in results], ddof=1))
    return Row(group.task, group.agent, len(results), group.runs, mean, std, plain, success, cpu_s, paper)


def table_fields(which: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return a table as ``--json`` prints it."""
    return {"table": TABLES[which].number, "cells": [row.fields() for row in rows]}


def table_text(which: str, rows: Sequence[Row]) -> str:
    """Return a table as Markdown."""
    head = ("task", "agent", "runs", "ours", "success", "paper")
    tests = ("difference (95 %)", "p", "p, Holm", "ours is", "core time")
    named = TABLES[which]
    return f"{named.number}: {named.title}\n\n" + markdown([(*head, *tests), *(row.texts() for row in rows)])


def coverage_text(groups: Sequence[dict[str, Any]]) -> str:
    """Return the groups of a budget as Markdown; runs of several commits were made at several times."""
    rows: list[tuple[str, ...]] = [("task", "agent", "runs", "core s a run", "ended by", "commits")]
    for group in groups:
        took = [group["cpu_s"] / group["made"]] if group["made"] else []
        took += [3600.0 * run["hours_to_run"] for run in group["unfinished"]]
        part = [f"seed {run['seed']} at {run['iterations']} of {run['of']}" for run in group["unfinished"]]
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
