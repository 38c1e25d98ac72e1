"""The paper's tables as text for people."""

from collections.abc import Sequence
from typing import Any

from sim.paper.tables import Entry
from sim.paper.tasks import TASKS


def table_text(entries: Sequence[Entry]) -> str:
    """Return a table as Markdown."""
    rows = [("task", "agent", "runs", "ours", "success", "paper", "verdict", "core time")]
    rows += [
        (
            TASKS[entry.task].title,
            entry.agent,
            f"{entry.runs} of {entry.wanted}",
            _mean(entry.mean, entry.std),
            "" if entry.success_rate is None else f"{entry.success_rate:.0%}",
            _published(entry),
            "" if entry.verdict is None else f"{entry.verdict} (p = {entry.p:.2g})",
            "" if entry.cpu_s is None else f"{entry.cpu_s:.0f} s",
        )
        for entry in entries
    ]
    return _markdown(rows)


def parameters_text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the experiments' parameters as Markdown."""
    keys = ("task", "horizon", "iterations", "rollouts", "worst", "success", "parameters", "default_steps")
    return _markdown([keys, *(tuple(str(row[key]) for key in keys) for row in rows)])


def time_constants_text(found: dict[str, Any]) -> str:
    """Return Table S7 as Markdown."""
    rows = [("neuron", "best circuit, s", f"all {found['runs']} circuits, s", "paper, s")]
    rows += [
        (row["neuron"], _range(row["best"]), _range(row["all"]), _range(row["published"]))
        for row in found["time_constants_s"]
    ]
    return _markdown(rows)


def contributions_text(found: dict[str, Any]) -> str:
    """Return Definition 1's signs as Markdown."""
    rows = [("neuron", "best circuit", f"all {found['runs']} circuits", "paper", "agree")]
    rows += [
        (
            f"{row['source']} to {row['destination']}",
            f"{row['best']['sign']} ({row['best']['positive']} : {row['best']['negative']})",
            ", ".join(f"{count} {sign}" for sign, count in sorted(row["circuits"].items())),
            str(row["published"]),
            str(row["agree"]),
        )
        for row in found["contributions"]
    ]
    return _markdown(rows)


def _mean(mean: float | None, std: float | None) -> str:
    if mean is None:
        return ""
    digits = 1 if abs(mean) >= 10 else 3
    spread = "" if std is None else f" ± {std:.{digits}f}"
    return f"{mean:.{digits}f}{spread}"


def _published(entry: Entry) -> str:
    if entry.published is None:
        return ""
    rate = entry.published.success_rate
    success = "" if rate is None else f" ({rate:.0%})"
    return f"{entry.published.mean:.1f} ± {entry.published.std:.1f}{success}"


def _range(ends: tuple[float, float] | None) -> str:
    return "" if ends is None else f"{ends[0]:.3g} .. {ends[1]:.3g}"


def _markdown(rows: Sequence[tuple[str, ...]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |"
        for row in rows
    ]
    return "\n".join([lines[0], "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines[1:]])
