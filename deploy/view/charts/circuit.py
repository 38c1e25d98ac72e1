"""Drawing of the circuit: its synapses, their mean currents, and each neuron's time constants."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.view.charts.figure import (
    AMBER,
    BLUE,
    GREY,
    INK,
    VERMILLION,
    Picture,
    figure,
    render,
    ring_radius,
)
from deploy.view.interpretation import TimeConstant
from deploy.view.layout import (
    HEIGHT,
    LAYERS,
    MARGIN,
    RADIUS,
    ROW,
    WIDTH,
    Curve,
    labels,
    lay_out,
    name_scale,
)
from deploy.view.trace import Trace, synapse_currents
from rover_ncp.circuit.circuit import SynapseKind

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import PathPatch

KINDS = {
    SynapseKind.EXCITATORY: (BLUE, "solid", "excitatory"),
    SynapseKind.INHIBITORY: (VERMILLION, "solid", "inhibitory"),
    SynapseKind.GAP: (INK, (0, (2, 1.5)), "gap junction"),
}
"""Colour, dash and name; excitation ends in an arrow, inhibition in a bar, a gap junction in a dot."""
LEFT = -92.0
"""Place of the layers' names and of the legend."""


def circuit(trace: Trace, time_constants: Sequence[TimeConstant]) -> Picture:
    """Draw a run's circuit. Lines are as thick as a synapse's mean absolute current over the run."""
    policy, layout = trace.policy, lay_out(trace.policy)
    current = np.abs(synapse_currents(policy.circuit, trace.potentials).current).mean(axis=0)
    strongest = max(float(current.max(initial=0.0)), 1e-12)
    drawn = figure(7.4, 8.4)
    axes = drawn.add_subplot()
    axes.set_xlim(LEFT - 3, WIDTH + 15)
    axes.set_ylim(HEIGHT + 105, -5)
    axes.set_aspect("equal")
    axes.axis("off")
    for curve, kind, mean in zip(layout.curves, policy.circuit.kind, current, strict=True):
        draw_synapse(axes, curve, SynapseKind(kind), 0.5 + 4.0 * float(np.sqrt(mean / strongest)))
    ranges, meanings = {row.neuron: row for row in time_constants}, labels(policy)
    label: dict[str, Any] = {"fontsize": 9, "color": INK, "ha": "center", "va": "center", "style": "italic"}
    for name, (x, y) in zip(policy.circuit.neurons, layout.places, strict=True):
        _draw_neuron(axes, name, x, y, ranges.get(name))
        above = name in policy.sensing.neurons
        axes.text(x, y - RADIUS - 16 if above else y + ring_radius(10.0) + 8, meanings.get(name, ""), **label)
    for number, row in enumerate(LAYERS):
        if row in layout.layers:
            axes.text(LEFT, MARGIN + ROW * number, row, fontsize=9.5, color=GREY, va="center", style="italic")
    y = HEIGHT + 48
    for number, (kind, (color, _, words)) in enumerate(KINDS.items()):
        x = LEFT + 165 * number
        draw_synapse(axes, Curve(x, y, x + 17, y, x + 34, y), kind, 2.0)
        axes.text(x + 48, y, words, fontsize=9, va="center", color=color)
    words = (
        f"thickest line: a current of {current.max(initial=0.0):.0f} mA, mean over the run\n"
        "amber ring: range of the time constant, its inner and outer rim on a logarithmic scale"
    )
    axes.text(LEFT, y + 32, words, fontsize=8.5, color=GREY, va="center", linespacing=1.4)
    return render(drawn)


def draw_synapse(axes: "Axes", curve: Curve, kind: SynapseKind, width: float) -> "PathPatch":
    """Draw a synapse; return its line, without the end that shows the kind."""
    from matplotlib.patches import PathPatch, Polygon
    from matplotlib.path import Path

    color, dash, _ = KINDS[kind]
    points = np.array(curve).reshape(3, 2)
    path = Path(points, [Path.MOVETO, Path.CURVE3, Path.CURVE3])
    style = {"edgecolor": color, "linewidth": width, "linestyle": dash}
    line = PathPatch(path, facecolor="none", alpha=0.85, **style)
    axes.add_patch(line)
    end = points[2]
    along = (end - points[1]) / np.hypot(*(end - points[1]))
    across = (5.0 + 0.8 * width) * np.array([-along[1], along[0]])
    if kind == SynapseKind.EXCITATORY:
        back = end - 3 * along
        corners = np.array([end + 6 * along, back + across, back - across])
        axes.add_patch(Polygon(corners, facecolor=color, edgecolor="white", linewidth=0.4, zorder=4))
    elif kind == SynapseKind.INHIBITORY:
        bar = np.array([end + 1.3 * across, end - 1.3 * across])
        axes.plot(*bar.T, color=color, linewidth=max(2.4, width), solid_capstyle="butt", zorder=4)
    else:
        axes.plot(*end, "o", color=color, markersize=5 + width / 2, zorder=4)
    return line


def _draw_neuron(axes: "Axes", name: str, x: float, y: float, tau: TimeConstant | None) -> None:
    from matplotlib.patches import Annulus, Circle

    axes.add_patch(Circle((x, y), RADIUS, facecolor="white", edgecolor=INK, linewidth=1.4, zorder=5))
    text: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 6}
    axes.text(x, y - 9 if tau else y, name, fontsize=10.5 * name_scale(name), weight="bold", **text)
    if tau is None:
        return
    inner, outer = ring_radius(tau.lowest_s), ring_radius(tau.highest_s)
    # A nearly constant time constant still needs a visible ring.
    width = max(outer - inner, 1.5)
    ring = Annulus((x, y), inner + width, width, linewidth=0.7, facecolor=f"{AMBER}66", edgecolor="#9A6A00")
    axes.add_patch(ring)
    words = f"{_seconds(tau.lowest_s)} to\n{_seconds(tau.highest_s)}"
    axes.text(x, y + 10, words, fontsize=6.6, linespacing=1.05, **text)


def _seconds(tau_s: float) -> str:
    return f"{1000 * tau_s:.2g} ms" if tau_s < 0.0995 else f"{tau_s:.2g} s"
