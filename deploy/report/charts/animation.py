"""A drive as an animated picture: the rover on its course, and the potentials and currents of its circuit."""

import io
from typing import Any

import numpy as np

from deploy.report.charts.circuit import draw_synapse
from deploy.report.charts.figure import (
    BLUE,
    INK,
    OUTLINE,
    POTENTIAL_HIGH_MV,
    POTENTIAL_LOW_MV,
    POTENTIAL_MAP,
    figure,
    placed,
)
from deploy.report.charts.path import draw_course
from deploy.report.layout import HEIGHT, RADIUS, WIDTH, label_lines, labels, lay_out, name_scale
from deploy.report.trace import Trace, synapse_currents
from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.course.course import Course

FORMATS = (".gif", ".webp")
FRAME_S = 0.4
"""Of the drive; a picture plays it four times as fast."""
SHOWN_MS, LAST_MS = 100, 2000
_DARK = 0.55
"""Above this part of the range of potentials a neuron is light, and its name dark."""


def animate(trace: Trace, course: Course, suffix: str) -> bytes:
    """Return a GIF or WebP of a run, which is repeated without end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    drawn = figure(9.0, 4.4)
    canvas: Any = FigureCanvasAgg(drawn)  # untyped
    drawing = _Drawing(drawn, trace, course)
    step = max(round(FRAME_S / trace.policy.tick_s), 1)
    ticks = [*range(0, len(trace.times) - 1, step), len(trace.times) - 1]
    frames = []
    for tick in ticks:
        drawing.show(tick)
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
        if tick == 0:
            drawn.set_layout_engine("none")  # solved once
    buffer = io.BytesIO()
    kind = suffix.removeprefix(".").upper()
    how: dict[str, Any] = {"quality": 60, "method": 4} if kind == "WEBP" else {"optimize": True}
    shown = [*[SHOWN_MS] * (len(frames) - 1), LAST_MS]
    frames[0].save(buffer, kind, save_all=True, append_images=frames[1:], duration=shown, loop=0, **how)
    return buffer.getvalue()


class _Drawing:
    """The parts of the picture that move."""

    def __init__(self, drawn: Any, trace: Trace, course: Course) -> None:
        from matplotlib import colormaps
        from matplotlib.patches import Circle

        self._trace = trace
        above, beside = drawn.subplots(1, 2, width_ratios=(1.0, 1.0))
        draw_course(above, course)
        corners = np.concatenate([placed(OUTLINE, pose) for pose in trace.poses])
        above.set_xlim(corners[:, 0].min() - 0.1, corners[:, 0].max() + 0.1)
        above.set_ylim(corners[:, 1].min() - 0.1, corners[:, 1].max() + 0.1)
        (self._path,) = above.plot([], [], color=BLUE, linewidth=2.5, zorder=4)
        (self._rover,) = above.plot([], [], color=INK, linewidth=1.5, zorder=6)
        self._title = above.set_title("", loc="left", fontsize=10, color=INK)

        policy, layout = trace.policy, lay_out(trace.policy)
        beside.set_xlim(-10, WIDTH + 10)
        beside.set_ylim(HEIGHT + 20, -20)
        beside.set_aspect("equal")
        beside.axis("off")
        beside.set_title(
            f"policy {policy.circuit.name}: potentials and currents", loc="left", fontsize=10, color=INK
        )
        current = np.abs(synapse_currents(policy.circuit, trace.potentials).current)
        self._widths = 0.3 + 4.0 * np.sqrt(current / max(float(current.max(initial=0.0)), 1e-12))
        self._lines = [
            draw_synapse(beside, curve, SynapseKind(kind), 0.3)
            for curve, kind in zip(layout.curves, policy.circuit.kind, strict=True)
        ]
        scaled = (trace.potentials - POTENTIAL_LOW_MV) / (POTENTIAL_HIGH_MV - POTENTIAL_LOW_MV)
        self._scaled = np.clip(scaled, 0.0, 1.0)
        self._colors = colormaps[POTENTIAL_MAP](self._scaled)
        meanings = labels(policy)
        self._neurons, self._names = [], []
        for name, (x, y) in zip(policy.circuit.neurons, layout.places, strict=True):
            self._neurons.append(beside.add_patch(Circle((x, y), RADIUS, edgecolor=INK, zorder=5)))
            text: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 6}
            size = 7.5 * name_scale(name)
            self._names.append(beside.text(x, y, name, fontsize=size, weight="bold", **text))
            away = -1 if name in policy.sensing.neurons else 1
            meaning = "\n".join(label_lines(meanings.get(name, "")))
            text |= {"va": "bottom" if away < 0 else "top"}
            beside.text(x, y + away * (RADIUS + 5), meaning, fontsize=7.5, style="italic", **text)

    def show(self, tick: int) -> None:
        """Show the moment after a tick."""
        poses = self._trace.poses
        self._path.set_data(*poses[: tick + 2, :2].T)
        self._rover.set_data(*placed(OUTLINE, poses[tick + 1]).T)
        self._title.set_text(f"{self._trace.times[tick]:.1f} s")
        for line, width in zip(self._lines, self._widths[tick], strict=True):
            line.set_linewidth(width)
        for neuron, name, color, part in zip(
            self._neurons, self._names, self._colors[tick], self._scaled[tick], strict=True
        ):
            neuron.set_facecolor(color)
            name.set_color(INK if part > _DARK else "white")
