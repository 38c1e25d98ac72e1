"""Learning curves of all runs: mean and deviation, as in the paper, beside median and middle half."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.learn.curve import png_of
from sim.paper import FAITHFUL, BudgetName
from sim.paper.agents import GRADIENTS, PAPERS
from sim.paper.results import Result, ResultStore
from sim.paper.tasks import TASKS, Task

_POINTS = 200
_WIDE = 100.0
"""Span of an axis that needs no labels between the powers of ten."""
_PARKING_RETURNS = (-6.0, 0.3)
"""Returns shown for parking; agents with a lower one do not drive to the goal."""
_AGENTS = (*PAPERS, *GRADIENTS)
_COLORS = dict(zip(_AGENTS, ("tab:blue", "tab:orange", "tab:green", "tab:red", "0.4", "0.7"), strict=True))
_KINDS = ("mean and deviation", "median and middle half")
_TASKS_IN_ROW = 2


def curves_png(store: ResultStore, budget: BudgetName = BudgetName.DEFAULT) -> bytes:
    """Return the learning curves of all runs of a budget as PNG. Raises FileError."""
    from matplotlib.figure import Figure

    found = {(task, agent): _results(store, task, agent, budget) for task in TASKS for agent in _AGENTS}
    tasks = [task for name, task in TASKS.items() if any(found[name, agent] for agent in _AGENTS)]
    columns = len(_KINDS) * min(max(len(tasks), 1), _TASKS_IN_ROW)
    rows = max(-(-len(tasks) // _TASKS_IN_ROW), 1)
    figure = Figure(figsize=(3.4 * columns, 2.6 * rows), dpi=100, layout="constrained")
    grid: Any = figure.subplots(rows, columns, squeeze=False)
    panels = list(grid.flat)
    for number, task in enumerate(tasks):
        pair = panels[len(_KINDS) * number : len(_KINDS) * (number + 1)]
        for axes, kind in zip(pair, _KINDS, strict=True):
            for agent in _AGENTS:
                if results := found[task.name, agent]:
                    _draw(axes, results, agent, kind)
            _finish(axes, task, kind)
        pair[1].sharey(pair[0])
    for axes in panels[len(_KINDS) * len(tasks) :]:
        axes.set_visible(False)
    figure.supxlabel("iterations" if budget in FAITHFUL else "steps of the environment", fontsize=9)
    figure.supylabel("estimated return of the best so far", fontsize=9)
    return png_of(figure)


def _finish(axes: Any, task: Task, kind: str) -> None:
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    axes.axhline(task.success, color="0.6", linewidth=0.8, linestyle=":")
    if task.success < 0:
        axes.set_ylim(_PARKING_RETURNS)
    axes.set_title(f"{task.title}\n{kind}", fontsize=7)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high < _WIDE * low else (1.0,)))
    axes.xaxis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="upper left" if task.success < 0 else "lower right")


def _results(store: ResultStore, task: str, agent: str, budget: BudgetName) -> list[Result]:
    """Return all runs that were searched for; one of PPO or A2C has no curve."""
    return [result for result in store.results(task, agent, budget) if result.curve]


def _draw(axes: Any, results: Sequence[Result], agent: str, kind: str) -> None:
    first = min(result.curve[0][0] for result in results)
    faithful = results[0].name.budget in FAITHFUL
    last = max(result.evaluations - 1 if faithful else result.steps for result in results)
    steps = np.geomspace(max(first, 1), last, _POINTS)
    rows = []
    for result in results:
        marks, estimates = np.array(result.curve).T
        # Before a run's first estimate, that one is shown; a run that its start solved is a level line.
        rows.append(estimates[np.maximum(np.searchsorted(marks, steps, side="right") - 1, 0)])
    values = np.array(rows)
    if kind == _KINDS[0]:
        middle, spread = values.mean(axis=0), values.std(axis=0, ddof=min(len(rows) - 1, 1))
        low, high = middle - spread, middle + spread
    else:
        low, middle, high = np.percentile(values, [25, 50, 75], axis=0)
    axes.fill_between(steps, low, high, color=_COLORS[agent], alpha=0.15, linewidth=0)
    axes.plot(steps, middle, color=_COLORS[agent], linewidth=1.5, label=f"{agent} ({len(results)})")
