"""Pictures of pairs of neurons: histograms of slopes, and phase plots coloured by time."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deploy.report.charts.figure import Picture, figure, render
from deploy.report.charts.style import BLUE, GREY, INK, VERMILLION
from deploy.report.interpretation import BINS, Contribution, Sign
from deploy.report.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SYMBOLS = {Sign.POSITIVE: "+", Sign.ANTAGONISTIC: "−", Sign.PHASE_SWITCHING: "±", Sign.NONE: "0"}
STILL_MV = 0.02
"""A tick in which no neuron moves more would be a dot on a dot."""
_TINTS = {
    Sign.POSITIVE: "#E3EFF7",
    Sign.ANTAGONISTIC: "#FBEADC",
    Sign.PHASE_SWITCHING: "#F3F4F6",
    Sign.NONE: "#FFFFFF",
}


def slope_histograms(
    found: Mapping[tuple[str, str], Contribution], sources: Sequence[str], destinations: Sequence[str]
) -> Picture:
    """Draw the slopes of each source (row) against each destination (column), as Definition 1 counts them."""
    small = len(destinations) > 6
    width, height = (1.25, 0.85) if small else (2.3, 1.1)
    drawn = figure(width * len(destinations) + 0.9, height * len(sources) + 0.9)
    axes = drawn.add_subplot()
    axes.axis("off")
    axes.set_xlim(-0.35, len(destinations))
    axes.set_ylim(len(sources) + 0.3, -0.15)
    for j, destination in enumerate(destinations):
        axes.text(j + 0.5, -0.02, f"→ {destination}", fontsize=10, color=INK, ha="center")
        for words, x in (("0", 0.5),) if small else (("−90°", 0.06), ("0", 0.5), ("90°", 0.94)):
            axes.text(j + x, len(sources) + 0.02, words, fontsize=7, color=GREY, ha="center", va="top")
    for i, source in enumerate(sources):
        axes.text(-0.04, i + 0.5, source, fontsize=10, color=INK, ha="right", va="center")
        for j, destination in enumerate(destinations):
            if source != destination:
                _histogram(axes, found[source, destination], j, i, small)
    words = "slopes from −90° to 90°, column over row; heights are roots of counts, grey is a slope of 0"
    axes.text(
        len(destinations) / 2, len(sources) + 0.28, words, fontsize=9, color=INK, ha="center", va="bottom"
    )
    return render(drawn)


def _histogram(axes: "Axes", one: Contribution, column: int, row: int, small: bool) -> None:
    """Draw one histogram into the unit cell whose corner is at (column, row), y down."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Rectangle

    tint = _TINTS[one.sign]
    axes.add_patch(Rectangle((column + 0.04, row + 0.05), 0.92, 0.88, facecolor=tint, linewidth=0))
    lefts = column + 0.06 + 0.88 * np.arange(BINS) / BINS
    counts = np.array(one.bins, float)
    flat = np.zeros(BINS)
    flat[BINS // 2] = one.flat
    # Roots: the steepest slopes, where one of the two hardly moves, are by far the most.
    scale = 0.66 / np.sqrt(max(counts.max(), 1.0))
    colors = [VERMILLION if number < BINS // 2 else BLUE for number in range(BINS)]
    middle = np.zeros(BINS)
    middle[BINS // 2] = counts[BINS // 2]
    heights = scale * np.sqrt(np.concatenate([middle, counts - flat]))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, -1.0], [0.0, -1.0]])
    width = 0.86 * 0.88 / BINS
    bars = [
        corners * [width, high] + [x, row + 0.93] for x, high in zip([*lefts, *lefts], heights, strict=True)
    ]
    axes.add_collection(PolyCollection(bars, facecolors=[GREY] * BINS + colors, linewidths=0), autolim=False)
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
    scale = Normalize(0.0, float(trace.times[1:][moving].max(initial=trace.policy.tick_s)))
    for i, source in enumerate(sources):
        for j, destination in enumerate(destinations):
            axes = grid[i, j]
            _bare(axes)
            if source == destination:
                axes.axis("off")
                continue
            points = np.column_stack([trace.of(source), trace.of(destination)])
            segments = np.stack([points[:-1], points[1:]], axis=1)[moving]
            line = LineCollection(
                segments, cmap="plasma", norm=scale, linewidth=2.2, array=trace.times[1:][moving]
            )
            axes.add_collection(line)
            axes.plot(*points[0], "o", color=INK, markersize=5, markerfacecolor="white", zorder=4)
            axes.plot(*points[-1], "s", color=INK, markersize=4.5, zorder=4)
            axes.autoscale_view()
            axes.margins(0.12)
            _ends(axes)
    _titles(grid, sources, destinations)
    bar = drawn.colorbar(ScalarMappable(scale, "plasma"), ax=grid, shrink=0.5, aspect=30)
    bar.set_label("time (s)", fontsize=9)
    drawn.supxlabel(
        "potentials in mV: source (row) across, destination (column) up; circle start, square end", fontsize=9
    )
    return render(drawn)


def _ends(axes: "Axes") -> None:
    """Label the ends of both axes, inside of their ends."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    axes.set_xticks([left, right], [_whole(left), _whole(right)], fontsize=7, color=GREY)
    axes.set_yticks([bottom, top], [_whole(bottom), _whole(top)], fontsize=7, color=GREY)
    for number, (x, y) in enumerate(zip(axes.get_xticklabels(), axes.get_yticklabels(), strict=True)):
        x.set_horizontalalignment("right" if number else "left")
        y.set_verticalalignment("top" if number else "bottom")


def _bare(axes: "Axes") -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#C5C9D0")
    axes.set_yticks([])
    axes.minorticks_off()
    axes.tick_params(length=2, color="#C5C9D0")


def _titles(
    grid: "np.ndarray[tuple[int, int], np.dtype[np.object_]]",
    sources: Sequence[str],
    destinations: Sequence[str],
) -> None:
    for axes, destination in zip(grid[0], destinations, strict=True):
        axes.set_title(f"→ {destination}", fontsize=10, color=INK)
    for axes, source in zip(grid[:, 0], sources, strict=True):
        axes.text(
            -0.22 if len(destinations) <= 6 else -0.14,
            0.5,
            source,
            transform=axes.transAxes,
            rotation=90,
            ha="center",
            va="center",
            fontsize=10,
            color=INK,
            clip_on=False,
        )


def _whole(value: float) -> str:
    return f"{value:.0f}".replace("-", "−")
