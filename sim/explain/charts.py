"""Charts of the what-ifs: a row for each missing part or changed parameter, with the result of the drive."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from deploy.view.charts.figure import (
    BLUE,
    DASHED,
    GREEN,
    GREY,
    INK,
    PALE,
    VERMILLION,
    Picture,
    figure,
    quiet,
    render,
)
from deploy.view.sentences import number
from sim.explain.task import TaskKnockout
from sim.explain.what_if import STEP, Knockout, Sensitivity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_M = 1e-3
"""Smaller distances are drawn here: the axis is logarithmic."""


def knock_out_chart(rows: Sequence[Knockout], intact_m: float, tolerance_m: float) -> Picture:
    """Draw the final position errors without each part, the largest on top, beside the intact circuit's."""
    rows = sorted(rows, key=lambda row: (row.error_m, -row.total))
    drawn, axes = _bars([row.title for row in rows], "The drive without each neuron and synapse")
    places = np.arange(len(rows))
    errors = np.maximum([row.error_m for row in rows], LEAST_M)
    intact_m = max(intact_m, LEAST_M)
    axes.hlines(places, intact_m, errors, color=PALE, linewidth=1.5)
    parked = np.array([row.parked for row in rows])
    for own, color, marker, words in (
        (parked, GREEN, "o", "still parks"),
        (~parked, VERMILLION, "X", "does not park"),
    ):
        axes.plot(errors[own], places[own], marker, color=color, markersize=7, label=words, linestyle="none")
    axes.axvline(intact_m, color=INK, linewidth=1, label="intact")
    axes.axvline(tolerance_m, color=GREY, linewidth=1, linestyle=DASHED, label="tolerance")
    axes.set_xscale("log")
    axes.set_xlabel("distance to the goal at the end (m, log scale); the number is the return")
    across = axes.get_yaxis_transform()
    for place, row in enumerate(rows):
        axes.text(1.01, place, number(row.total, 2), fontsize=7, color=GREY, va="center", transform=across)
    return _finished(drawn, axes)


def return_chart(rows: Sequence[TaskKnockout], intact: float) -> Picture:
    """Draw the mean returns without each part, the lowest on top, beside the intact circuit's."""
    rows = sorted(rows, key=lambda row: -row.total)
    drawn, axes = _bars([row.title for row in rows], "The episodes without each neuron and synapse")
    places = np.arange(len(rows))
    totals = [row.total for row in rows]
    axes.hlines(places, intact, totals, color=PALE, linewidth=1.5)
    axes.plot(totals, places, "o", color=VERMILLION, markersize=6, label="without", linestyle="none")
    axes.axvline(intact, color=INK, linewidth=1, label="intact")
    axes.set_xlabel("mean return")
    return _finished(drawn, axes, "lower left")


def sensitivity_chart(rows: Sequence[Sensitivity]) -> Picture:
    """Draw the fall of the return in both directions of each parameter, the deepest on top."""
    rows = sorted(rows, key=lambda row: -row.worst)
    drawn, axes = _bars(
        [row.title for row in rows], f"The return when a parameter moves by {100 * STEP:g} % of its range"
    )
    places = np.arange(len(rows))
    for changes, offset, color, hatch, words in (
        ([row.change_down for row in rows], 0.19, VERMILLION, "////", "a little lower"),
        ([row.change_up for row in rows], -0.19, BLUE, "", "a little higher"),
    ):
        falls = -np.array(changes)
        axes.barh(places + offset, falls, 0.36, color=color, hatch=hatch, ec="white", lw=0, label=words)
    axes.set_xscale("symlog", linthresh=1e-3, linscale=0.5)
    axes.axvline(0, color=INK, linewidth=1)
    axes.set_xlabel("fall of the return (log scale beyond 0.001; left of 0 it rises)")
    return _finished(drawn, axes)


def _bars(names: Sequence[str], title: str) -> "tuple[Figure, Axes]":
    drawn = figure(7.4, 0.2 * len(names) + 1.3)
    axes = drawn.add_subplot()
    quiet(axes)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(-0.7, len(names) - 0.3)
    axes.grid(axis="y", visible=False)
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    return drawn, axes


def _finished(
    drawn: "Figure", axes: "Axes", legend: Literal["lower left", "lower right"] = "lower right"
) -> Picture:
    axes.legend(loc=legend, fontsize=8, frameon=True, framealpha=0.9, edgecolor="none")
    return render(drawn)
