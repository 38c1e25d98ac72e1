"""The rover's path from above, plain and coloured by the activity of each neuron."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deploy.report.charts.figure import Picture, figure, quiet, render
from deploy.report.charts.shapes import LENGTH_M, OUTLINE, placed, rectangle
from deploy.report.charts.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    POTENTIAL_HIGH_MV,
    POTENTIAL_LOW_MV,
    POTENTIAL_MAP,
    VERMILLION,
)
from deploy.report.layout import Layer, labels, layers
from deploy.report.phases import Phase
from deploy.report.trace import Trace
from rover_ncp.course.course import Course

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

STOOD_M = 5e-4
ARROW_M = 0.05
LABEL_M = 0.055

_TURNS = {1: (BLUE, "left turn"), -1: (VERMILLION, "right turn"), 0: (GREY, "straight")}


def trajectory(trace: Trace, course: Course, found: Sequence[Phase]) -> Picture:
    """Draw the whole manoeuvre: checkpoints with deadlines, the path by phases, start and end."""
    drawn = figure(7.6, 6.2)
    axes = drawn.add_subplot()
    setting(axes, course)
    for pose, dash, words in ((trace.poses[0], (0, (2, 2)), "start"), (trace.poses[-1], "solid", "end")):
        axes.plot(*placed(OUTLINE, pose).T, color=GREY, linewidth=1, linestyle=dash)
        nose = placed(np.array([[LENGTH_M / 2, 0.0]]), pose)[0]
        axes.annotate(words, nose, xytext=(3, 3), textcoords="offset points", fontsize=8, color=GREY)
    in_legend = set()
    for number, phase in enumerate(found, 1):
        way = trace.poses[phase.first : phase.last + 1]
        color, words = _TURNS[phase.signs[1]]
        dash = "solid" if phase.signs[1] >= 0 else (0, (5, 1))
        label = None if words in in_legend or phase.signs == (0, 0) else words
        in_legend.add(words if label else None)
        axes.plot(way[:, 0], way[:, 1], color=color, linewidth=3, linestyle=dash, label=label, zorder=4)
        if phase.driven_m > 0.02:
            middle = way[len(way) // 2]
            _badge(axes, middle, number, color)
    _checkpoints(axes, trace, course)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    axes.set_title("Path from above, by phases", loc="left", fontsize=11, color=INK)
    return render(drawn)


def activity(trace: Trace, course: Course) -> Picture:
    """Draw the path once for each neuron, painted with its potential."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    rows = [
        [n for n, own in zip(trace.neurons, layers(trace.policy), strict=True) if own is row] for row in Layer
    ]
    rows = [row for row in rows if row]
    columns = max(map(len, rows))
    drawn = figure(2.3 * columns + 1.0, 1.95 * len(rows))
    grid = drawn.subplots(len(rows), columns, squeeze=False, sharex=True, sharey=True)
    scale = Normalize(POTENTIAL_LOW_MV, POTENTIAL_HIGH_MV)
    way = trace.poses[:, :2]
    # Where the rover stood nothing new would be painted: the last potential lies on top.
    moved = np.append(np.hypot(*np.diff(way, axis=0).T)[:-1] > STOOD_M, True)
    segments = np.stack([way[:-1], way[1:]], axis=1)[moved]
    meanings = labels(trace.policy)
    for number, row in enumerate(rows):
        for place in range(columns):
            axes = grid[number, place]
            if place >= len(row):
                axes.set_visible(False)
                continue
            quiet(axes)
            potential = trace.of(row[place])[moved]
            widths = 1.5 + 8.5 * scale(potential)
            painted = LineCollection(
                segments, cmap=POTENTIAL_MAP, norm=scale, linewidths=widths, capstyle="round", array=potential
            )
            axes.add_collection(painted)
            axes.update_datalim(way)
            axes.plot(*course.goal[:2], marker="x", color=INK, markersize=6, zorder=5)
            low, high = trace.of(row[place]).min(), trace.of(row[place]).max()
            sensed = f" [{meanings[row[place]]}]" if row[place] in trace.policy.sensing.neurons else ""
            axes.set_title(f"{row[place]}{sensed}", loc="left", fontsize=10, color=INK)
            axes.text(
                0.03,
                0.97,
                f"{low:.0f} to {high:.0f} mV".replace("-", "−"),
                transform=axes.transAxes,
                va="top",
                fontsize=8,
                color=GREY,
            )
            axes.set_aspect("equal")
            axes.margins(0.15)
            if place == 0:
                axes.set_ylabel("y (m)", fontsize=8)
    for axes in grid[-1, : len(rows[-1])]:
        axes.set_xlabel("x (m)", fontsize=8)
    bar = drawn.colorbar(ScalarMappable(scale, POTENTIAL_MAP), ax=grid, shrink=0.6, pad=0.02)
    bar.set_label("potential (mV); thicker is higher", fontsize=9)
    return render(drawn)


def setting(axes: "Axes", course: Course) -> None:
    """Draw obstacles and the goal with its tolerance."""
    from matplotlib.patches import Circle, Polygon

    quiet(axes)
    for obstacle in course.obstacles:
        where = rectangle(obstacle.length, obstacle.width, (obstacle.x, obstacle.y, obstacle.theta))
        axes.add_patch(Polygon(where, facecolor="#E3E5E9", edgecolor=GREY, hatch="///", linewidth=1))
    goal, rule = course.goal, course.parked
    axes.add_patch(
        Circle(
            (goal.x, goal.y),
            rule.position_m,
            facecolor="none",
            edgecolor=GREEN,
            linewidth=1.4,
            linestyle=(0, (4, 2)),
            label=f"goal, {100 * rule.position_m:.0f} cm around",
        )
    )
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _badge(axes: "Axes", where: Any, number: int, color: str) -> None:
    axes.annotate(
        str(number),
        where[:2],
        fontsize=8,
        fontweight="bold",
        color="white",
        ha="center",
        va="center",
        zorder=6,
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": color, "edgecolor": "white"},
    )


def _checkpoints(axes: "Axes", trace: Trace, course: Course) -> None:
    """Draw the checkpoints, the rover's distance from each at its deadline, and the deadlines."""
    points = np.array([point.pose for point in course.checkpoints])
    times = np.append(trace.times, trace.times[-1] + trace.policy.tick_s)
    above: dict[tuple[float, float], bool] = {}
    for point in course.checkpoints:
        there = trace.poses[min(int(np.searchsorted(times, point.t - 1e-9)), len(times) - 1)]
        axes.plot(*zip((point.x, point.y), there[:2], strict=True), color=INK, linewidth=0.8, linestyle=":")
        dx, dy = there[0] - point.x, there[1] - point.y
        # The label stands on the other side of the checkpoint's heading than the rover did.
        left = np.cos(point.theta) * dy - np.sin(point.theta) * dx < -1e-3
        above[round(point.x, 3), round(point.y, 3)] = bool(left)
    arrows = ARROW_M * np.column_stack([np.cos(points[:, 2]), np.sin(points[:, 2])])
    axes.quiver(
        *points[:, :2].T,
        *arrows.T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.003,
        zorder=5,
        color=INK,
    )
    axes.plot(*points[:, :2].T, "o", color=INK, markersize=4, zorder=5, label="checkpoint, heading")
    axes.plot([], [], ":", color=INK, linewidth=0.8, label="miss at its deadline")
    places: dict[tuple[float, float], list[float]] = {}
    for point in course.checkpoints:
        places.setdefault((round(point.x, 3), round(point.y, 3)), []).append(point.t)
    labelled: list[tuple[float, float]] = []
    # Those that wait in one place first: of labels that would lie on each other only one is written.
    for (x, y), when in sorted(places.items(), key=lambda item: -len(item[1])):
        if all(np.hypot(x - other[0], y - other[1]) > LABEL_M for other in labelled):
            labelled.append((x, y))
            words = f"{when[0]:.0f} s" if len(when) == 1 else f"{when[0]:.0f} to {when[-1]:.0f} s"
            right = not above[x, y] or len(when) > 1
            beside = (6 if right else -5, 6 if above[x, y] else -12)
            axes.annotate(
                words,
                (x, y),
                xytext=beside,
                textcoords="offset points",
                ha="left" if right else "right",
                fontsize=8,
                color=INK,
            )
