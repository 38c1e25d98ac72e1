"""The path from above: by phases, by the potential of each neuron, and as a course demands it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.view.charts.figure import (
    BLUE,
    DASHED,
    GREEN,
    GREY,
    INK,
    OUTLINE,
    POTENTIAL_HIGH_MV,
    POTENTIAL_LOW_MV,
    POTENTIAL_MAP,
    VERMILLION,
    FloatArray,
    Picture,
    figure,
    placed,
    quiet,
    rectangle,
    render,
)
from deploy.view.layout import LAYERS, labels, layers
from deploy.view.phases import Phase
from deploy.view.trace import Trace
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.feasibility import Drivability
from rover_ncp.course.reference import Reference, plan_reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STOOD_M = 5e-4
"""In a tick with less motion the rover stood."""
ARROW_M = 0.05
LABEL_M = 0.055
"""Least distance between two labels of deadlines."""
OUTLINE_EVERY = round(2.0 / TICK_S)
"""Ticks between outlines on the path of a course."""
TURNS: dict[int, tuple[str, Any, str]] = {
    1: (BLUE, "solid", "left turn"),
    -1: (VERMILLION, (0, (5, 1)), "right turn"),
    0: (GREY, "solid", "straight, standing"),
}
"""Colour, dash and name by the sign of omega."""


def trajectory(trace: Trace, course: Course, found: Sequence[Phase]) -> Picture:
    """Draw the whole manoeuvre: checkpoints with deadlines, the path by phases, start and end."""
    drawn = figure(7.6, 6.2)
    axes = drawn.add_subplot()
    draw_course(axes, course)
    targets = [point.pose for point in course.checkpoints]
    follows = RoverInterface(trace.policy).needs_reference
    if follows:
        reference = plan_reference(course)
        targets = [reference.at(point.t)[0] for point in course.checkpoints]
        _draw_reference(axes, course, reference)
    _draw_ends(axes, trace.poses)
    for turn, (color, dash, words) in TURNS.items():
        if any(phase.signs[1] == turn for phase in found):
            axes.plot([], [], color=color, linestyle=dash, linewidth=3, label=words)
    for number, phase in enumerate(found, 1):
        way = trace.poses[phase.first : phase.last + 1]
        color, dash, _ = TURNS[phase.signs[1]]
        axes.plot(way[:, 0], way[:, 1], color=color, linewidth=3, linestyle=dash, zorder=4)
        if phase.driven_m > 0.02:
            badge = {"boxstyle": "circle,pad=0.25", "facecolor": color, "edgecolor": "white"}
            x, y, _ = way[len(way) // 2]
            axes.text(
                x, y, str(number), fontsize=8, weight="bold", color="white", ha="center", va="center",
                zorder=6, bbox=badge,
            )  # fmt: skip
    times = np.append(trace.times, trace.times[-1] + trace.policy.tick_s)
    for point, target in zip(course.checkpoints, targets, strict=True):
        there = trace.poses[min(int(np.searchsorted(times, point.t - 1e-9)), len(times) - 1)]
        axes.plot([target.x, there[0]], [target.y, there[1]], color=INK, linewidth=0.8, linestyle=":")
    axes.plot([], [], ":", color=INK, linewidth=0.8, label="miss at its time")
    if not follows:
        _draw_times(axes, deadlines(course))
    _draw_legend(axes)
    axes.set_title("Path from above, by phases", loc="left", fontsize=11, color=INK)
    return render(drawn)


def drive_chart(
    course: Course, truth: Sequence[Pose], estimate: Sequence[Pose], outline: FloatArray = OUTLINE
) -> Picture:
    """Draw the true and the estimated path of a drive, and where its reference is at which time."""
    drawn = figure(7.6, 6.2)
    axes = drawn.add_subplot()
    draw_course(axes, course)
    _draw_reference(axes, course, plan_reference(course))
    _draw_ends(axes, np.array(truth), outline)
    for poses, color, dash, words in (
        (truth, BLUE, "solid", "true path"),
        (estimate, VERMILLION, "dashed", "estimate"),
    ):
        axes.plot(*np.array(poses)[:, :2].T, color=color, linestyle=dash, linewidth=2, label=words)
    _draw_legend(axes)
    return render(drawn)


def activity(trace: Trace, course: Course) -> Picture:
    """Draw the path once for each neuron, coloured by its potential."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import Normalize

    own = layers(trace.policy)
    rows = [[n for n, of in zip(trace.neurons, own, strict=True) if of == row] for row in LAYERS]
    rows = [row for row in rows if row]
    columns = max(map(len, rows))
    drawn = figure(2.3 * columns + 1.0, 1.95 * len(rows))
    grid = drawn.subplots(len(rows), columns, squeeze=False, sharex=True, sharey=True)
    scale = Normalize(POTENTIAL_LOW_MV, POTENTIAL_HIGH_MV)
    way = trace.poses[:, :2]
    # Segments of a standing rover would cover each other; the last one is drawn on top.
    moved = np.append(np.hypot(*np.diff(way, axis=0).T)[:-1] > STOOD_M, True)
    segments = np.stack([way[:-1], way[1:]], axis=1)[moved]
    meanings = {
        name: label for name, label in labels(trace.policy).items() if name in trace.policy.sensing.neurons
    }
    for line, row in zip(grid, rows, strict=True):
        for axes in line[len(row) :]:
            axes.set_visible(False)
        for axes, name in zip(line, row, strict=False):
            quiet(axes)
            potential = trace.of(name)
            axes.add_collection(
                LineCollection(
                    segments,
                    cmap=POTENTIAL_MAP,
                    norm=scale,
                    linewidths=1.5 + 8.5 * scale(potential[moved]),
                    capstyle="round",
                    array=potential[moved],
                )
            )
            axes.update_datalim(way)
            axes.plot(*course.goal[:2], marker="x", color=INK, markersize=6, zorder=5)
            sensed = f" [{meanings[name]}]" if name in meanings else ""
            axes.set_title(f"{name}{sensed}", loc="left", fontsize=10, color=INK)
            words = f"{potential.min():.0f} to {potential.max():.0f} mV".replace("-", "−")
            axes.text(0.03, 0.97, words, transform=axes.transAxes, va="top", fontsize=8, color=GREY)
            axes.set_aspect("equal")
            axes.margins(0.15)
        line[0].set_ylabel("y (m)", fontsize=8)
    for axes in grid[-1, : len(rows[-1])]:
        axes.set_xlabel("x (m)", fontsize=8)
    bar = drawn.colorbar(ScalarMappable(scale, POTENTIAL_MAP), ax=grid, shrink=0.6, pad=0.02)
    bar.set_label("potential (mV); thicker is higher", fontsize=9)
    return render(drawn)


def course_picture(course: Course, found: Drivability, outline: FloatArray = OUTLINE) -> Picture:
    """Draw a course with its reference; crosses and causes mark checkpoints that cannot be driven."""
    drawn = figure(7.6, 6.2)
    axes = drawn.add_subplot()
    draw_course(axes, course)
    way = found.reference.poses
    forward = found.reference.motion[:, 0] >= 0
    for which, (color, dash, _), words in (
        (forward, TURNS[1], "reference, forward"),
        (~forward, TURNS[-1], "reference, backward"),
    ):
        if which[1:].any():
            line = np.where(which[:, None], way[:, :2], np.nan)
            axes.plot(*line.T, color=color, linestyle=dash, linewidth=2.5, label=words, zorder=4)
    for pose in way[::OUTLINE_EVERY]:
        axes.plot(*placed(outline, pose).T, color=GREY, linewidth=0.5, alpha=0.6)
    _draw_ends(axes, way, outline)
    bad = sorted({problem.checkpoint for problem in found.problems})
    label = "cannot be driven"
    for number in bad:
        causes = dict.fromkeys(p.cause.value for p in found.problems if p.checkpoint == number)
        x, y, _ = course.checkpoints[number - 1].pose
        axes.plot(x, y, "X", color=VERMILLION, markersize=11, zorder=6, label=label)
        label = "_nolegend_"
        axes.annotate(
            f"{number}: {', '.join(causes)}",
            (x, y),
            xytext=(8, 8),
            textcoords="offset points",
            fontsize=8,
            color=VERMILLION,
            zorder=7,
        )
    _draw_legend(axes)
    verdict, color = ("drivable", GREEN) if found.drivable else ("not drivable", VERMILLION)
    axes.set_title(f"{course.name}: {verdict}", loc="left", fontsize=11, color=color)
    return render(drawn)


def deadlines(course: Course) -> list[tuple[float, float, str]]:
    """Return the places of the checkpoints (x, y in m) with their deadlines, most checkpoints first.

    A drawing skips labels that would cover one of an earlier place.
    """
    return _by_place([(point.x, point.y, point.t) for point in course.checkpoints])


def _by_place(points: Sequence[tuple[float, float, float]]) -> list[tuple[float, float, str]]:
    places: dict[tuple[float, float], list[float]] = {}
    for x, y, t in points:
        places.setdefault((round(x, 3), round(y, 3)), []).append(t)
    ordered = sorted(places.items(), key=lambda item: -len(item[1]))
    return [
        (x, y, f"{times[0]:.0f} s" if len(times) == 1 else f"{times[0]:.0f} to {times[-1]:.0f} s")
        for (x, y), times in ordered
    ]


def draw_course(axes: "Axes", course: Course) -> None:
    """Draw obstacles, checkpoints, and the goal with its tolerance."""
    from matplotlib.patches import Circle, Polygon

    quiet(axes)
    for obstacle in course.obstacles:
        corners = rectangle(obstacle.length, obstacle.width, (obstacle.x, obstacle.y, obstacle.theta))
        axes.add_patch(Polygon(corners, facecolor="#E3E5E9", edgecolor=GREY, hatch="///", linewidth=1))
    radius = course.parked.position_m
    style = {"facecolor": "none", "edgecolor": GREEN, "linewidth": 1.4, "linestyle": DASHED}
    axes.add_patch(Circle(course.goal[:2], radius, label=f"goal, {100 * radius:.0f} cm around", **style))
    points = np.array([point.pose for point in course.checkpoints])
    arrows = ARROW_M * np.array([np.cos(points[:, 2]), np.sin(points[:, 2])])
    how: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "headlength": 3.5}
    axes.quiver(*points[:, :2].T, *arrows, units="inches", width=0.02, color=GREY, zorder=3, **how)
    axes.plot(*points[:, :2].T, "o", color=GREY, markersize=4, zorder=3, label="checkpoint, heading")
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _draw_reference(axes: "Axes", course: Course, reference: Reference) -> None:
    """Draw the path of the moving reference, and where it is at the deadlines."""
    axes.plot(*reference.poses[:, :2].T, color=GREEN, linewidth=4, alpha=0.45, label="moving reference")
    poses = [(point.t, reference.at(point.t)[0]) for point in course.checkpoints]
    points = np.array([pose[:2] for _, pose in poses])
    axes.plot(*points.T, "D", color=GREEN, markersize=5, zorder=5, label="reference at these times")
    _draw_times(axes, _by_place([(pose.x, pose.y, t) for t, pose in poses]))


def _draw_legend(axes: "Axes") -> None:
    """Draw the legend below the axes, where it covers nothing."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=5, ncols=4, fontsize=8, frameon=False
    )


def _draw_times(axes: "Axes", times: Sequence[tuple[float, float, str]]) -> None:
    from matplotlib.patheffects import withStroke

    labelled: list[tuple[float, float]] = []
    for x, y, words in times:
        if all(np.hypot(x - other[0], y - other[1]) > LABEL_M for other in labelled):
            labelled.append((x, y))
            # The place where it stands has the label with two times, which needs more room.
            offset, align = ((6, -12), "left") if " to " in words else ((-6, 6), "right")
            label = axes.annotate(
                words, (x, y), xytext=offset, textcoords="offset points", ha=align, fontsize=8, zorder=7
            )
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _draw_ends(axes: "Axes", poses: FloatArray, outline: FloatArray = OUTLINE) -> None:
    """Draw the rover's outline at the start, dashed, and at the end."""
    for words, pose, dash in (("start", poses[0], (0, (2, 2))), ("end", poses[-1], "solid")):
        axes.plot(*placed(outline, pose).T, color=GREY, linewidth=1, linestyle=dash)
        nose = placed(outline[:2].mean(axis=0, keepdims=True), pose)[0]
        axes.annotate(words, nose, xytext=(3, 3), textcoords="offset points", fontsize=8, color=GREY)
