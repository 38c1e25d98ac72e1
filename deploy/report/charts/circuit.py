"""Drawing of the circuit: its synapses, their mean strength, and each neuron's time constants."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from deploy.report.charts.figure import Picture, figure, render
from deploy.report.charts.style import AMBER, BLUE, GREY, INK, VERMILLION, ring_radius
from deploy.report.currents import synapse_currents
from deploy.report.interpretation import TimeConstant
from deploy.report.layout import HEIGHT, RADIUS, ROW, WIDTH, Curve, Layer, labels, lay_out
from deploy.report.trace import Trace
from rover_ncp.circuit.circuit import SynapseKind

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KINDS = {
    SynapseKind.EXCITATORY: (BLUE, "solid", "excitatory"),
    SynapseKind.INHIBITORY: (VERMILLION, "solid", "inhibitory"),
    SynapseKind.GAP: (INK, (0, (2, 1.5)), "gap junction"),
}
"""Colour, dash and name; excitation ends in an arrow, inhibition in a bar, a gap junction in a dot."""


def circuit(trace: Trace, taus: Sequence[TimeConstant]) -> Picture:
    """Draw a run's circuit. Lines are as thick as a synapse's mean absolute current over the run."""
    policy, layout = trace.policy, lay_out(trace.policy)
    current = np.abs(synapse_currents(policy.circuit, trace.potentials).current).mean(axis=0)
    strongest = max(float(current.max(initial=0.0)), 1e-12)
    drawn = figure(7.4, 8.4)
    axes = drawn.add_subplot()
    axes.set_xlim(-95, WIDTH + 15)
    axes.set_ylim(HEIGHT + 105, -5)
    axes.set_aspect("equal")
    axes.axis("off")
    ranges = {row.neuron: row for row in taus}
    meanings = labels(policy)
    for curve, kind, mean in zip(layout.curves, policy.circuit.kind, current, strict=True):
        _synapse(axes, curve, SynapseKind(kind), 0.5 + 4.0 * float(np.sqrt(mean / strongest)))
    for name, (x, y) in zip(policy.circuit.neurons, layout.places, strict=True):
        _neuron(axes, name, x, y, ranges.get(name))
        if name in meanings:
            above = name in policy.sensing.neurons
            _label(axes, x, y - RADIUS - 16 if above else y + ring_radius(10.0) + 8, meanings[name])
    for number, row in enumerate(Layer):
        if row in layout.layers:
            axes.text(
                -92, 60 + ROW * number, row.value, fontsize=9.5, color=GREY, va="center", style="italic"
            )
    _legend(axes, float(current.max(initial=0.0)))
    return render(drawn)


def _synapse(axes: "Axes", curve: Curve, kind: SynapseKind, width: float) -> None:
    from matplotlib.patches import PathPatch, Polygon
    from matplotlib.path import Path

    color, dash, _ = KINDS[kind]
    end, control = np.array([curve.x1, curve.y1]), np.array([curve.cx, curve.cy])
    along = (end - control) / max(float(np.hypot(*(end - control))), 1e-9)
    path = Path(
        [(curve.x0, curve.y0), (curve.cx, curve.cy), (curve.x1, curve.y1)],
        [Path.MOVETO, Path.CURVE3, Path.CURVE3],
    )
    axes.add_patch(
        PathPatch(path, facecolor="none", edgecolor=color, linewidth=width, linestyle=dash, alpha=0.85)
    )
    across = np.array([-along[1], along[0]])
    size = 5.0 + 0.8 * width
    if kind == SynapseKind.EXCITATORY:
        corners = np.array(
            [end + 6 * along, end - 3 * along + size * across, end - 3 * along - size * across]
        )
        axes.add_patch(Polygon(corners, facecolor=color, edgecolor="white", linewidth=0.4, zorder=4))
    elif kind == SynapseKind.INHIBITORY:
        bar = np.array([end + (size + 2) * across, end - (size + 2) * across])
        axes.plot(*bar.T, color=color, linewidth=max(2.4, width), solid_capstyle="butt", zorder=4)
    else:
        axes.plot(*end, "o", color=color, markersize=5 + width / 2, zorder=4)


def _neuron(axes: "Axes", name: str, x: float, y: float, tau: TimeConstant | None) -> None:
    from matplotlib.patches import Annulus, Circle

    if tau is not None:
        inner, outer = ring_radius(tau.lowest_s), ring_radius(tau.highest_s)
        # A time constant that hardly changes still has a ring one can see.
        width = max(outer - inner, 1.5)
        ring = Annulus((x, y), inner + width, width, facecolor=AMBER, alpha=0.4, linewidth=0, zorder=1)
        axes.add_patch(ring)
        for radius in (inner, inner + width):
            axes.add_patch(
                Circle((x, y), radius, facecolor="none", edgecolor="#9A6A00", linewidth=0.7, zorder=1)
            )
    axes.add_patch(Circle((x, y), RADIUS, facecolor="white", edgecolor=INK, linewidth=1.4, zorder=5))
    words = "" if tau is None else f"{_seconds(tau.lowest_s)} to\n{_seconds(tau.highest_s)}"
    axes.text(
        x, y - (9 if words else 0), name, fontsize=10.5, weight="bold", ha="center", va="center", zorder=6
    )
    axes.text(x, y + 10, words, fontsize=6.6, ha="center", va="center", color=INK, zorder=6, linespacing=1.05)


def _label(axes: "Axes", x: float, y: float, words: str) -> None:
    axes.text(x, y, words, fontsize=9, color=INK, ha="center", va="center", style="italic")


def _seconds(tau_s: float) -> str:
    return f"{1000 * tau_s:.2g} ms" if tau_s < 0.0995 else f"{tau_s:.2g} s"


def _legend(axes: "Axes", strongest: float) -> None:
    y = HEIGHT + 48
    for number, (kind, (color, _, words)) in enumerate(KINDS.items()):
        x = -85 + 165 * number
        _synapse(axes, Curve(x, y, x + 17, y, x + 34, y), kind, 2.0)
        axes.text(x + 48, y, words, fontsize=9, va="center", color=color)
    words = (
        f"thickest line: a current of {strongest:.0f} mA, mean over the run\n"
        "amber ring: range of the time constant, its inner and outer rim on a logarithmic scale"
    )
    axes.text(-85, y + 32, words, fontsize=8.5, color=GREY, va="center", linespacing=1.4)
