"""The picture that ``rover-ncp park`` ends with: where the rover should have been, and where it was."""

import io
from collections.abc import Sequence

import numpy as np

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import Course

# The outline of a Pioneer 3-AT in m (arcos.md's table of physical parameters: 626 by 505 mm).
_LENGTH, _WIDTH = 0.626, 0.505


def trajectory_png(course: Course, truth: Sequence[Pose], estimate: Sequence[Pose]) -> bytes:
    """Return a PNG of a run from above: checkpoints with their deadlines, true and estimated path."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon

    figure = Figure(figsize=(8, 6), dpi=120, layout="constrained")
    axes = figure.add_subplot()
    for obstacle in course.obstacles:
        corners = _rectangle(Pose(obstacle.x, obstacle.y, obstacle.theta), obstacle.length, obstacle.width)
        axes.add_patch(Polygon(corners, facecolor="0.6", edgecolor="0.3", hatch="//"))
    for pose, style in ((truth[0], ":"), (truth[-1], "-")):
        axes.add_patch(
            Polygon(_rectangle(pose, _LENGTH, _WIDTH), fill=False, edgecolor="0.5", linestyle=style)
        )
    axes.plot([p.x for p in truth], [p.y for p in truth], color="tab:blue", linewidth=2, label="true path")
    axes.plot(
        [p.x for p in estimate],
        [p.y for p in estimate],
        color="tab:orange",
        linewidth=1.2,
        linestyle="--",
        label="estimate",
    )
    points = course.checkpoints
    axes.quiver(
        [p.x for p in points],
        [p.y for p in points],
        np.cos([p.theta for p in points]),
        np.sin([p.theta for p in points]),
        color="0.15",
        width=0.003,
        scale=28,
        label="checkpoints",
    )
    seen: set[tuple[float, float]] = set()
    for point in points:
        if (point.x, point.y) not in seen:
            seen.add((point.x, point.y))
            axes.annotate(
                f"{point.t:.0f} s",
                (point.x, point.y),
                xytext=(4, -11),
                textcoords="offset points",
                fontsize=7,
                color="0.35",
            )
    goal = course.goal
    angle = np.linspace(0, 2 * np.pi, 73)
    radius = course.parked.position_m
    axes.plot(
        goal.x + radius * np.cos(angle),
        goal.y + radius * np.sin(angle),
        color="tab:green",
        linewidth=1,
        label=f"{radius:.2f} m around the goal",
    )
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _rectangle(pose: Pose, length: float, width: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    return np.asarray(corners @ np.array([[c, s], [-s, c]]) + [pose.x, pose.y])
