"""Bar charts of ablations and sensitivities: a row for each changed part, with the result of the drive."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deploy.report.charts.figure import Picture, figure, quiet, render
from deploy.report.charts.style import BLUE, GREEN, GREY, INK, VERMILLION

LEAST_M = 1e-3


class Outcome(NamedTuple):
    """A drive under another condition: its distance to the goal at the end, its return, whether it parked."""

    name: str
    error_m: float
    total: float
    parked: bool


class Swing(NamedTuple):
    """A parameter, and the changes of the return when it was moved down and up."""

    name: str
    down: float
    up: float


def outcomes(rows: Sequence[Outcome], intact: Outcome, tolerance_m: float, title: str) -> Picture:
    """Draw the parking errors, the largest on top, beside the intact drive's."""
    rows = sorted(rows, key=lambda row: (row.error_m, -row.total))
    drawn = figure(7.4, 0.19 * len(rows) + 1.3)
    axes = drawn.add_subplot()
    quiet(axes)
    places = np.arange(len(rows))
    errors = np.maximum([row.error_m for row in rows], LEAST_M)
    axes.hlines(places, max(intact.error_m, LEAST_M), errors, color="#C5C9D0", linewidth=1.5)
    for parked, color, marker, words in (
        (True, GREEN, "o", "still parks"),
        (False, VERMILLION, "X", "does not park"),
    ):
        own = [i for i, row in enumerate(rows) if row.parked is parked]
        axes.plot(errors[own], places[own], marker, color=color, markersize=7, label=words, linestyle="none")
    axes.axvline(max(intact.error_m, LEAST_M), color=INK, linewidth=1, label="intact")
    axes.axvline(tolerance_m, color=GREY, linewidth=1, linestyle=(0, (4, 2)), label="tolerance")
    axes.set_xscale("log")
    axes.set_yticks(places, [row.name.replace("->", "→") for row in rows], fontsize=8)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("distance to the goal at the end (m, log scale); the number is the return")
    for place, row in zip(places, rows, strict=True):
        words = f"{row.total:.2f}".replace("-", "−")
        axes.annotate(
            words,
            (1.0, place),
            xycoords=("axes fraction", "data"),
            xytext=(4, 0),
            textcoords="offset points",
            fontsize=7,
            color=GREY,
            va="center",
        )
    axes.legend(loc="lower right", fontsize=8, frameon=True, framealpha=0.9, edgecolor="none")
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    return render(drawn)


def swings(rows: Sequence[Swing], title: str) -> Picture:
    """Draw by how much the return fell, for either direction, the deepest on top."""
    rows = sorted(rows, key=lambda row: -min(row.down, row.up))
    drawn = figure(7.4, 0.23 * len(rows) + 1.3)
    axes = drawn.add_subplot()
    quiet(axes)
    places = np.arange(len(rows))
    for values, offset, color, hatch, words in (
        ([row.down for row in rows], 0.19, VERMILLION, "////", "a little lower"),
        ([row.up for row in rows], -0.19, BLUE, "", "a little higher"),
    ):
        axes.barh(
            places + offset,
            -np.array(values),
            height=0.36,
            color=color,
            hatch=hatch,
            edgecolor="white",
            linewidth=0,
            label=words,
        )
    axes.set_xscale("symlog", linthresh=1e-3, linscale=0.5)
    axes.axvline(0, color=INK, linewidth=1)
    axes.set_yticks(places, [row.name.replace("->", "→") for row in rows], fontsize=8)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("by how much the return falls (log scale beyond 0.001; left of 0 it rises)")
    axes.legend(loc="lower right", fontsize=8, frameon=True, framealpha=0.9, edgecolor="none")
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    return render(drawn)
