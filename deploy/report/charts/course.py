"""A course from above: its checkpoints, the drive that comes nearest to them, and the obstacles."""

import numpy as np

from deploy.report.charts.figure import Picture, figure, render
from deploy.report.charts.shapes import OUTLINE, placed
from deploy.report.charts.style import BLUE, GREEN, GREY, INK, VERMILLION
from deploy.report.charts.trajectory import setting
from rover_ncp.course.course import Course
from rover_ncp.course.feasibility import Drivability

ARROW_M = 0.06
OUTLINE_EVERY_S = 2.0


def course_picture(course: Course, found: Drivability) -> Picture:
    """Draw a course with its reference; where it cannot be driven there are crosses and words."""
    drawn = figure(7.6, 6.2)
    axes = drawn.add_subplot()
    setting(axes, course)
    way = found.reference.poses
    forward = found.reference.motion[:, 0] >= 0
    for which, color, dash, words in (
        (forward, BLUE, "solid", "reference, forward"),
        (~forward, VERMILLION, (0, (5, 1)), "reference, backward"),
    ):
        if which[1:].any():
            line = np.where(which[:, None], way[:, :2], np.nan)
            axes.plot(*line.T, color=color, linestyle=dash, linewidth=2.5, label=words, zorder=4)
    for pose in way[:: round(OUTLINE_EVERY_S * 10)]:
        axes.plot(*placed(OUTLINE, pose).T, color=GREY, linewidth=0.5, alpha=0.6)
    for pose, dash, words in ((way[0], (0, (2, 2)), "start"), (way[-1], "solid", "end")):
        axes.plot(*placed(OUTLINE, pose).T, color=INK, linewidth=1, linestyle=dash, label=words)
    points = np.array([point.pose for point in course.checkpoints])
    arrows = ARROW_M * np.column_stack([np.cos(points[:, 2]), np.sin(points[:, 2])])
    axes.quiver(
        *points[:, :2].T,
        *arrows.T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.003,
        color=INK,
        zorder=5,
    )
    axes.plot(*points[:, :2].T, "o", color=INK, markersize=4, zorder=5, label="checkpoint, heading")
    bad = sorted({problem.checkpoint - 1 for problem in found.problems})
    if bad:
        axes.plot(
            *points[bad, :2].T, "X", color=VERMILLION, markersize=11, zorder=6, label="cannot be driven"
        )
    for place in bad:
        causes = dict.fromkeys(p.cause.value for p in found.problems if p.checkpoint == place + 1)
        axes.annotate(
            f"{place + 1}: {', '.join(causes)}",
            (points[place, 0], points[place, 1]),
            xytext=(8, 8),
            textcoords="offset points",
            fontsize=8,
            color=VERMILLION,
            zorder=7,
        )
    axes.legend(loc="best", fontsize=8, frameon=False)
    verdict = "drivable" if found.drivable else "not drivable"
    color = GREEN if found.drivable else VERMILLION
    axes.set_title(f"{course.name}: {verdict}", loc="left", fontsize=11, color=color)
    return render(drawn)
