"""Learning curves of the published search, mean and standard deviation, as in the paper's figure 4."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sim.learn.curve import png_of
from sim.paper import BudgetName
from sim.paper.agents import PAPERS
from sim.paper.results import Result, ResultStore
from sim.paper.tasks import TASKS

_POINTS = 200
_PARKING_RETURNS = (-6.0, 0.3)
"""Returns shown for parking; agents with a lower one do not drive to the goal."""
_COLORS = dict(zip(PAPERS, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True))
_COLUMNS = 3


def curves_png(store: ResultStore) -> bytes:
    """Return the learning curves as PNG. Raises FileError."""
    from matplotlib.figure import Figure

    found = {
        name: {agent: runs for agent in PAPERS if (runs := store.results(name, agent, BudgetName.PUBLISHED))}
        for name in TASKS
    }
    tasks = [TASKS[name] for name, agents in found.items() if agents]
    rows = max(-(-len(tasks) // _COLUMNS), 1)
    figure = Figure(figsize=(3.4 * _COLUMNS, 2.6 * rows), dpi=100, layout="constrained")
    panels: list[Any] = list(figure.subplots(rows, _COLUMNS, squeeze=False).flat)
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
    return png_of(figure)


def average(runs: Sequence[Result]) -> tuple[Any, Any, Any]:
    """Return iterations (n,), and mean and standard deviation (n,) of the estimates of all runs."""
    curves = [np.array([(point[0], point[2]) for point in run.curve], np.float64) for run in runs]
    marks = np.geomspace(1.0, max(2, *(run.settings["iterations"] for run in runs)), _POINTS)
    # Before a run's first estimate, that one counts.
    rows = [
        curve[np.maximum(np.searchsorted(curve[:, 0], marks, side="right") - 1, 0), 1] for curve in curves
    ]
    return marks, np.mean(rows, axis=0), np.std(rows, axis=0, ddof=min(len(rows) - 1, 1))
