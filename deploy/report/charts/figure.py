"""Output of matplotlib figures to files: the same numbers give the same bytes, on any machine."""

import io
from typing import TYPE_CHECKING, NamedTuple

from deploy.report.charts.style import GREY, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Picture(NamedTuple):
    """A picture in both formats."""

    svg: bytes
    png: bytes


def figure(width: float, height: float) -> "Figure":
    """Return an empty figure of a size in inches, which lays out its axes by itself."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def quiet(axes: "Axes") -> None:
    """Leave of the frame what helps reading: thin axes left and below, a faint grid."""
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

    # The layout is found once; left to itself matplotlib finds it anew for each file.
    engine = drawn.get_layout_engine()
    if engine is not None:
        engine.execute(drawn)
        drawn.set_layout_engine("none")
    files = []
    # A fixed salt for the names of clip paths, and no date: otherwise no two files would be the same.
    with mpl.rc_context({"svg.hashsalt": "rover-ncp", "svg.fonttype": "path"}):
        for kind, metadata in (("svg", {"Date": None, "Creator": None}), ("png", {"Software": None})):
            buffer = io.BytesIO()
            drawn.savefig(buffer, format=kind, dpi=150, bbox_inches="tight", metadata=metadata)
            files.append(buffer.getvalue())
    return Picture(*files)
