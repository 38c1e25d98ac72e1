"""Figures as files, the shapes in them, and their colours.

The same numbers give the same bytes on any machine. Colours are safe for colour-blind readers, and a shape,
a dash, a number or a word repeats the meaning of each. The qualitative colours are those of Okabe and Ito;
potentials use matplotlib's viridis, whose lightness rises monotonically.
"""

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.robot.description import Circle, RobotDescription, load_description

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

BLUE, VERMILLION, GREEN, AMBER = "#0072B2", "#D55E00", "#009E73", "#E69F00"
INK, GREY, PALE = "#1B1F24", "#6B7280", "#C5C9D0"
DASHED = (0, (4, 2))

POTENTIAL_MAP = "viridis"
POTENTIAL_LOW_MV, POTENTIAL_HIGH_MV = -90.0, 0.0
"""Range of all potentials; colours mean the same in every figure."""


_UNIT = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) / 2
_SIDES = 36
"""Of a round outline."""


def outline_of(robot: RobotDescription) -> FloatArray:
    """Return a robot's outline (n, 2) in its own frame, closed, in m; the first two points are its front."""
    if isinstance(robot.footprint, Circle):
        turns = np.linspace(0.0, math.tau, _SIDES + 1) + math.pi / _SIDES
        return robot.footprint.radius_m * np.column_stack([np.cos(turns), np.sin(turns)])[::-1]
    front, rear, half = robot.front_m, -robot.rear_m, robot.width_m / 2
    return np.array([[front, half], [front, -half], [rear, -half], [rear, half], [front, half]])


OUTLINE = outline_of(load_description(DEFAULT_ROBOT))
"""That of the robot that courses and policies were made for."""


class Picture(NamedTuple):
    """A figure in both formats."""

    svg: bytes
    png: bytes


def figure(width: float, height: float) -> "Figure":
    """Return an empty figure of a size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def quiet(axes: "Axes") -> None:
    """Reduce the frame to thin axes left and below and a faint grid."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
    axes.tick_params(colors=GREY, labelcolor=INK, labelsize=8)
    axes.grid(color="#D9DCE1", linewidth=0.6)
    axes.set_axisbelow(True)


def render(drawn: "Figure") -> Picture:
    """Return a figure as SVG and PNG."""
    import matplotlib as mpl

    # Solve the layout once; otherwise matplotlib solves it again for each file.
    engine = drawn.get_layout_engine()
    if engine is not None:
        engine.execute(drawn)
        drawn.set_layout_engine("none")
    files = []
    # A fixed salt for the names of clip paths, and no date, make the bytes reproducible.
    with mpl.rc_context({"svg.hashsalt": "rover-ncp", "svg.fonttype": "path"}):
        for kind, metadata in (("svg", {"Date": None, "Creator": None}), ("png", {"Software": None})):
            buffer = io.BytesIO()
            drawn.savefig(buffer, format=kind, dpi=150, bbox_inches="tight", metadata=metadata)
            files.append(buffer.getvalue())
    return Picture(*files)


def placed(corners: FloatArray, pose: Sequence[float]) -> FloatArray:
    """Transform corners (k, 2) from a body's frame into the frame of its pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    moved: FloatArray = corners @ np.array([[c, s], [-s, c]]) + np.asarray(pose[:2])
    return moved


def rectangle(length: float, width: float, pose: Sequence[float]) -> FloatArray:
    """Return the corners (5, 2) of a rectangle, closed."""
    return placed(_UNIT * [length, width], pose)


def ring_radius(tau_s: float) -> float:
    """Return the radius of a time constant's ring in the units of `layout`: 34 for 0.1 ms, 6 a decade."""
    return 34.0 + 6.0 * math.log10(max(tau_s, 1e-4) / 1e-4)
