"""Pictures by matplotlib: a course, and the paths of a drive on its course.

Colours are those of Okabe and Ito, safe for colour-blind readers. A shape, a dash or a word repeats
the meaning of each.
"""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.patheffects import withStroke

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.feasibility import Drivability
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.shapes import OUTLINE, FloatArray, at_places, placed, rectangle

BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
INK, GREY = "#1B1F24", "#6B7280"
DASHED = (0, (4, 2))
ARROW_M = 0.05
MIN_LABEL_DISTANCE_M = 0.055
OUTLINE_EVERY = round(2.0 / TICK_S)
"""Ticks between outlines on the path of a course."""


def render(drawn: Figure, kind: str) -> bytes:
    """Return a figure as a file, ``svg`` or ``png``; the same numbers give the same bytes on any machine."""
    buffer = io.BytesIO()
    metadata = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
    # A fixed salt for the names of clip paths makes the bytes reproducible.
    with mpl.rc_context({"svg.hashsalt": "rover-ncp", "svg.fonttype": "path"}):
        drawn.savefig(buffer, format=kind, dpi=150, bbox_inches="tight", metadata=metadata)
    return buffer.getvalue()


def drive_picture(
    course: Course, truth: Sequence[Pose], estimate: Sequence[Pose], outline: FloatArray = OUTLINE
) -> Figure:
    """Draw the true and the estimated path of a drive, and where its reference is at which time."""
    drawn, axes = _figure(course)
    _draw_reference(axes, course, plan_reference(course))
    _draw_ends(axes, np.array(truth), outline)
    for poses, color, dash, words in (
        (truth, BLUE, "solid", "true path"),
        (estimate, VERMILLION, "dashed", "estimate"),
    ):
        axes.plot(*np.array(poses)[:, :2].T, color=color, linestyle=dash, linewidth=2, label=words)
    _draw_legend(axes)
    return drawn


def course_picture(course: Course, found: Drivability, outline: FloatArray = OUTLINE) -> Figure:
    """Draw a course with its reference; crosses and causes mark checkpoints that cannot be driven."""
    drawn, axes = _figure(course)
    way = found.reference.poses
    forward = found.reference.motion[:, 0] >= 0
    for which, color, dash, words in (
        (forward, BLUE, "solid", "reference, forward"),
        (~forward, VERMILLION, (0, (5, 1)), "reference, backward"),
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
    return drawn


def _figure(course: Course) -> tuple[Figure, Axes]:
    """Return a figure with obstacles, checkpoints, and the goal with its tolerance."""
    drawn = Figure(figsize=(7.6, 6.2), layout="constrained")
    axes = drawn.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(colors=GREY, labelcolor=INK, labelsize=8)
    axes.grid(color="#D9DCE1", linewidth=0.6)
    axes.set_axisbelow(True)
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
    return drawn, axes


def _draw_reference(axes: Axes, course: Course, reference: Reference) -> None:
    """Draw the path of the moving reference, and where it is at the deadlines."""
    axes.plot(*reference.poses[:, :2].T, color=GREEN, linewidth=4, alpha=0.45, label="moving reference")
    poses = [(point.t, reference.at(point.t)[0]) for point in course.checkpoints]
    points = np.array([pose[:2] for _, pose in poses])
    axes.plot(*points.T, "D", color=GREEN, markersize=5, zorder=5, label="reference at these times")
    _draw_times(axes, at_places([(pose.x, pose.y, t) for t, pose in poses]))


def _draw_legend(axes: Axes) -> None:
    """Draw the legend below the axes, where it covers nothing."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=5, ncols=4, fontsize=8, frameon=False
    )


def _draw_times(axes: Axes, times: Sequence[tuple[float, float, str]]) -> None:
    labelled: list[tuple[float, float]] = []
    for x, y, words in times:
        if all(np.hypot(x - other[0], y - other[1]) > MIN_LABEL_DISTANCE_M for other in labelled):
            labelled.append((x, y))
            # The place where it stands has the label with two times, which needs more room.
            offset, align = ((6, -12), "left") if " to " in words else ((-6, 6), "right")
            label = axes.annotate(
                words, (x, y), xytext=offset, textcoords="offset points", ha=align, fontsize=8, zorder=7
            )
            label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def _draw_ends(axes: Axes, poses: FloatArray, outline: FloatArray = OUTLINE) -> None:
    """Draw the rover's outline at the start, dashed, and at the end."""
    for words, pose, dash in (("start", poses[0], (0, (2, 2))), ("end", poses[-1], "solid")):
        axes.plot(*placed(outline, pose).T, color=GREY, linewidth=1, linestyle=dash)
        nose = placed(outline[:2].mean(axis=0, keepdims=True), pose)[0]
        axes.annotate(words, nose, xytext=(3, 3), textcoords="offset points", fontsize=8, color=GREY)
