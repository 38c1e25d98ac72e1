"""Figures of pairs of neurons: histograms of slopes, and phase plots coloured by time."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.view.charts.figure import BLUE, GREY, INK, PALE, VERMILLION, Picture, figure, render
from deploy.view.interpretation import BINS, SYMBOLS, Contribution, Sign
from deploy.view.sentences import number
from deploy.view.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STILL_MV = 0.02
"""A tick in which no neuron changes more is not drawn: its segment would be a dot."""
TINTS = {
    Sign.POSITIVE: "#E3EFF7",
    Sign.ANTAGONISTIC: "#FBEADC",
    Sign.PHASE_SWITCHING: "#F3F4F6",
    Sign.NONE: "none",
}


def slope_histograms(
    found: Mapping[tuple[str, str], Contribution], sources: Sequence[str], destinations: Sequence[str]
) -> Picture:
    """Draw the slopes of each source (row) against each destination (column), as Definition 1 counts them."""
    small = len(destinations) > 6
    width, height = (1.25, 0.85) if small else (2.3, 1.1)
    drawn = figure(width * len(destinations) + 0.9, height * len(sources) + 0.9)
    # One axes with a unit cell for each pair: a hundred axes take matplotlib half a minute.
    axes = drawn.add_subplot()
    axes.axis("off")
    axes.set_xlim(-0.35, len(destinations))
    axes.set_ylim(len(sources) + 0.3, -0.15)
    for column, destination in enumerate(destinations):
        axes.text(column + 0.5, -0.02, f"→ {destination}", fontsize=10, color=INK, ha="center")
        for words, x in (("0", 0.5),) if small else (("−90°", 0.06), ("0", 0.5), ("90°", 0.94)):
            place = column + x, len(sources) + 0.02
            axes.text(*place, words, fontsize=7, color=GREY, ha="center", va="top")
    for row, source in enumerate(sources):
        axes.text(-0.04, row + 0.5, source, fontsize=10, color=INK, ha="right", va="center")
        for column, destination in enumerate(destinations):
            if source != destination:
                _draw_histogram(axes, found[source, destination], column, row, small)
    words = "slopes from −90° to 90°, column over row; heights are roots of counts, grey is a slope of 0"
    axes.text(len(destinations) / 2, len(sources) + 0.28, words, fontsize=9, color=INK, ha="center")
    return render(drawn)


def _draw_histogram(axes: "Axes", one: Contribution, column: int, row: int, small: bool) -> None:
    """Draw one histogram into the unit cell at (column, row); y points down."""
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((column + 0.04, row + 0.05), 0.92, 0.88, facecolor=TINTS[one.sign], linewidth=0))
    counts = np.array(one.bins, float)
    # Roots, because the steepest slopes outnumber all others by far.
    scale = 0.66 / np.sqrt(max(counts.max(), 1.0))
    middle = BINS // 2
    x = column + 0.06 + 0.88 * np.arange(BINS) / BINS
    bars: dict[str, Any] = {"bottom": row + 0.93, "width": 0.076, "align": "edge", "linewidth": 0}
    axes.bar(x[middle], -scale * np.sqrt(counts[middle]), color=GREY, **bars)
    counts[middle] -= one.flat
    colors = [VERMILLION] * middle + [BLUE] * (BINS - middle)
    axes.bar(x, -scale * np.sqrt(counts), color=colors, **bars)
    axes.plot([column + 0.5] * 2, [row + 0.05, row + 0.93], color=GREY, linewidth=0.7)
    words = SYMBOLS[one.sign] if small else f"{SYMBOLS[one.sign]}  P {one.positive}, Q {one.negative}"
    axes.text(column + 0.07, row + 0.08, words, fontsize=9, weight="bold", color=INK, va="top")


def phase_plots(trace: Trace, sources: Sequence[str], destinations: Sequence[str]) -> Picture:
    """Draw each source's potential (across) against each destination's (up), coloured by time."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    drawn = figure(2.3 * len(destinations) + 1.6, 1.5 * len(sources) + 0.6)
    grid = drawn.subplots(len(sources), len(destinations), squeeze=False)
    moving = np.abs(np.diff(trace.potentials, axis=0)).max(axis=1) > STILL_MV
    times = trace.times[1:][moving]
    scale = Normalize(0.0, float(times.max(initial=trace.policy.tick_s)))
    for row, source in zip(grid, sources, strict=True):
        for axes, destination in zip(row, destinations, strict=True):
            points = np.column_stack([trace.of(source), trace.of(destination)])
            segments = np.stack([points[:-1], points[1:]], axis=1)[moving]
            axes.add_collection(
                LineCollection(segments, cmap="plasma", norm=scale, linewidth=2.2, array=times)
            )
            axes.plot(*points[0], "o", color=INK, markersize=5, markerfacecolor="white", zorder=4)
            axes.plot(*points[-1], "s", color=INK, markersize=4.5, zorder=4)
            axes.margins(0.12)
            axes.autoscale_view()
            _draw_frame(axes)
        row[0].set_ylabel(source, fontsize=10, color=INK, labelpad=18)
    for axes, destination in zip(grid[0], destinations, strict=True):
        axes.set_title(f"→ {destination}", fontsize=10, color=INK)
    bar = drawn.colorbar(ScalarMappable(scale, "plasma"), ax=grid, shrink=0.5, aspect=30)
    bar.set_label("time (s)", fontsize=9)
    words = "potentials in mV: source (row) across, destination (column) up; circle start, square end"
    drawn.supxlabel(words, fontsize=9)
    return render(drawn)


def _draw_frame(axes: "Axes") -> None:
    """Draw thin axes left and below with labels at their ends only."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(PALE)
    axes.tick_params(length=2, color=PALE, labelcolor=GREY, labelsize=7)
    for axis, limits, inward in (
        (axes.xaxis, axes.get_xlim(), ({"ha": "left"}, {"ha": "right"})),
        (axes.yaxis, axes.get_ylim(), ({"va": "bottom"}, {"va": "top"})),
    ):
        axis.set_ticks(limits, [number(limit) for limit in limits])
        for label, side in zip(axis.get_ticklabels(), inward, strict=True):
            label.set(**side)
