"""Learning curves as in the paper's figure: each task's median of the runs and their middle half."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.paper.agents import AGENTS
from sim.paper.results import Result, ResultStore
from sim.paper.tasks import TASKS

_POINTS = 200
_WIDE = 100.0
"""Span of an axis that needs no labels between the powers of ten."""
_LOWEST_RETURN = -6.0
"""Lowest return shown for parking; agents with a lower one do not drive to the goal."""
_COLORS = dict(zip(AGENTS, ("tab:blue", "tab:orange", "tab:green", "tab:red", "0.4", "0.7"), strict=True))


def curves_png(store: ResultStore) -> bytes:
    """Return the learning curves of all runs as PNG. Raises FileError."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    found = {(task, agent): _results(store, task, agent) for task in TASKS for agent in AGENTS}
    tasks = [task for name, task in TASKS.items() if any(found[name, agent] for agent in AGENTS)]
    columns = min(max(len(tasks), 1), 3)
    rows = max(-(-len(tasks) // columns), 1)
    figure = Figure(figsize=(4.6 * columns, 3.1 * rows), dpi=100, layout="constrained")
    grid: Any = figure.subplots(rows, columns, squeeze=False)
    for axes, task in zip(grid.flat, tasks, strict=False):
        for agent in AGENTS:
            if results := found[task.name, agent]:
                _draw(axes, results, agent)
        if task.success < 0:
            axes.set_ylim(bottom=_LOWEST_RETURN)
        axes.axhline(task.success, color="0.6", linewidth=0.8, linestyle=":")
        axes.set_title(task.title, fontsize=9)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high < _WIDE * low else (1.0,)))
        axes.xaxis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7, loc="lower right")
    for axes in list(grid.flat)[len(tasks) :]:
        axes.set_visible(False)
    figure.supxlabel("steps of the environment", fontsize=9)
    figure.supylabel("estimated return of the best so far", fontsize=9)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _results(store: ResultStore, task: str, agent: str) -> list[Result]:
    return [result for result in store.results(task, agent) if len(result.curve) > 1]


def _draw(axes: Any, results: Sequence[Result], agent: str) -> None:
    first = min(result.curve[0][0] for result in results)
    last = max(result.steps for result in results)
    steps = np.geomspace(max(first, 1), last, _POINTS)
    values = []
    for result in results:
        marks, estimates = np.array(result.curve).T
        # Before a run's first estimate, that one is shown.
        values.append(estimates[np.maximum(np.searchsorted(marks, steps, side="right") - 1, 0)])
    low, middle, high = np.nanpercentile(values, [25, 50, 75], axis=0)
    axes.fill_between(steps, low, high, color=_COLORS[agent], alpha=0.15, linewidth=0)
    axes.plot(steps, middle, color=_COLORS[agent], linewidth=1.5, label=f"{agent} ({len(results)})")
