"""Drawing of a circuit: the layer of each neuron, a place for each neuron and a curve for each synapse.

Neurons are drawn in four rows: sensory, inter, command (those with a synapse onto a motor neuron) and motor.
The neurons of the shipped wirings have a fixed order within their rows; the neurons of other wirings are
ordered by the mean place of their neighbours. Coordinates: x to the right, y down, rows are `ROW` apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rover_ncp.circuit.policy import Policy
from rover_ncp.neurons.trace import FloatArray

WIDTH, HEIGHT, ROW = 560.0, 600.0, 160.0
RADIUS = 30.0
"""Of a neuron."""
MARGIN = 60.0
MAX_GAP = 190.0
"""Largest distance between neighbours in a row. Rows of different lengths then interleave."""
LAYERS = ("sensory", "inter", "command", "motor")
ORDER = ["PVD", "AVM", "PLM", "ALM", "DVA", "PVC", "AVD", "AVB", "AVA", "LFT", "FWD", "REV", "RGT"]
"""Neurons of the shipped wirings, in each row from left to right."""
FITTING = 5
"""Letters of a name that fit into a neuron."""
FITTING_SMALL, NAME_LINES = 6, 2
"""Smaller letters that fit into a neuron's line, and lines of a longer name."""
MOTIONS = {("v", 1): "forward", ("v", -1): "backward", ("omega", 1): "left", ("omega", -1): "right"}
"""What a part of a rover's command does, by its sign."""
SWEEPS = 4
BENDS = (0.0, 0.08, -0.08, 0.15, -0.15, 0.25, -0.25)
"""Distances of a curve's middle from the straight line, in lengths of the line."""
CLEARANCE = RADIUS + 6.0
"""Least distance of a curve to the centre of a neuron that is not one of its ends."""

Curve = tuple[float, ...]
"""A quadratic curve: x and y of the rim of one neuron, of the control point, of the rim of another neuron."""


@dataclass(frozen=True)
class Layout:
    """The drawing: a layer and a place for each neuron (n), a curve for each synapse (m)."""

    layers: tuple[str, ...]
    places: tuple[tuple[float, float], ...]
    curves: tuple[Curve, ...]


def layers(policy: Policy) -> tuple[str, ...]:
    """Return each neuron's layer."""
    circuit = policy.circuit
    motors = {neuron for channel in policy.motors.channels for neuron, _ in channel.sides}
    ends = zip(circuit.source, circuit.destination, strict=True)
    commands = {circuit.neurons[source] for source, to in ends if circuit.neurons[to] in motors}
    sets = (set(policy.sensing.neurons), motors, commands)
    names = ("sensory", "motor", "command")
    return tuple(
        next((name for name, members in zip(names, sets, strict=True) if neuron in members), "inter")
        for neuron in circuit.neurons
    )


def labels(policy: Policy) -> dict[str, str]:
    """Return the inputs of sensory neurons and what motor neurons do, as in ``heading > 0`` and ``left``.

    Of a channel that a layer mixes, the label has the two strongest parts: ``speed − heading > 0`` is sensed,
    ``forward, right`` is driven. Parts below a quarter of the strongest are left out.
    """
    sensing, motors = policy.sensing, policy.motors
    found: dict[str, str] = {}
    for number, channel in enumerate(sensing.channels):
        name = channel.name
        if policy.input_layer is not None:
            parts = _strongest(sensing.inputs, policy.input_layer[number])
            plus, minus = ([part for part, weight in parts if weight * side > 0] for side in (1, -1))
            name = " + ".join(plus) + "".join(f" − {part}" for part in minus)
        for neuron, end in channel.sides:
            one_sided = len(channel.sides) == 1 and policy.input_layer is None
            found[neuron] = name if one_sided else f"{name.strip()} {'>' if end > 0 else '<'} 0"
    for number, channel in enumerate(motors.channels):
        layer = np.eye(len(motors.outputs)) if policy.output_layer is None else policy.output_layer
        one_sided = len(channel.sides) == 1 and policy.output_layer is None
        for neuron, end in channel.sides:
            parts = _strongest(motors.outputs, end * layer[:, number])
            driven = [
                MOTIONS.get((name, 1 if weight > 0 else -1))
                or (name if one_sided else f"{name} {'>' if weight > 0 else '<'} 0")
                for name, weight in parts
            ]
            found[neuron] = ", ".join([*([found[neuron]] if neuron in found else []), *driven])
    return found


def label_lines(label: str) -> list[str]:
    """Return a label as lines that fit between neighbours: each further part of a mixture on its own."""
    return label.replace(" + ", "\n+ ").replace(" − ", "\n− ").split("\n")


def _strongest(names: Sequence[str], weights: FloatArray) -> list[tuple[str, float]]:
    """Return the two largest weights of a mixture, with their names, in the order of the names."""
    least = max(np.sort(np.abs(weights))[-2:][0], 0.25 * np.abs(weights).max())
    return [(name, float(w)) for name, w in zip(names, weights, strict=True) if abs(w) >= least]


def name_lines(name: str) -> list[str]:
    """Return a neuron's name as lines that fit into its circle on a page; "…" stands for the rest."""
    if len(name) <= FITTING:
        return [name]
    lines, rest = list[str](), name
    while rest and len(lines) < NAME_LINES:
        # Beside an underscore if one is near the end of the line.
        ends = [end for end in range(FITTING_SMALL, 2, -1) if "_" in rest[end - 1 : end + 1]]
        lines.append(rest[: ends[0] if ends and len(rest) > FITTING_SMALL else FITTING_SMALL])
        rest = rest[len(lines[-1]) :]
    return [*lines[:-1], lines[-1][: FITTING_SMALL - 1] + "…"] if rest else lines


def lay_out(policy: Policy) -> Layout:
    """Return the drawing of a policy's circuit."""
    circuit, layer = policy.circuit, layers(policy)
    rows = [[i for i, own in enumerate(layer) if own == row] for row in LAYERS]
    edges = list(zip(circuit.source.tolist(), circuit.destination.tolist(), strict=True))
    if set(circuit.neurons) <= set(ORDER):
        rows = [sorted(row, key=lambda i: ORDER.index(circuit.neurons[i])) for row in rows]
    else:
        rows = _ordered(rows, edges)
    places = _placed(rows)
    return Layout(
        layers=layer,
        places=tuple((float(x), float(y)) for x, y in places),
        curves=tuple(_curve(places, a, b, (b, a) in edges[:number]) for number, (a, b) in enumerate(edges)),
    )


def _placed(rows: Sequence[Sequence[int]]) -> FloatArray:
    places = np.zeros((sum(map(len, rows)), 2))
    for number, row in enumerate(rows):
        gap = min((WIDTH - 2 * MARGIN) / max(len(row) - 1, 1), MAX_GAP)
        for place, neuron in enumerate(row):
            places[neuron] = WIDTH / 2 + gap * (place - (len(row) - 1) / 2), MARGIN + ROW * number
    return places


def _ordered(rows: list[list[int]], edges: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Order each row by the mean x of its neurons' neighbours, in several sweeps over the rows."""
    for _ in range(SWEEPS):
        for number, row in enumerate(rows):
            x = _placed(rows)[:, 0]
            means = {
                i: np.mean([x[b] if a == i else x[a] for a, b in edges if i in (a, b)] or [x[i]]) for i in row
            }
            rows[number] = sorted(row, key=lambda i: means[i])
    return rows


def _curve(places: FloatArray, source: int, to: int, bent: bool) -> Curve:
    """Draw a synapse straight, or bent around other neurons.

    ``bent`` is for the second synapse of two neurons that drive each other.
    """
    a, b = places[source], places[to]
    if source == to:  # a loop to the right of the neuron
        return a[0] + RADIUS, a[1] - 8.0, a[0] + 2.6 * RADIUS, a[1], a[0] + RADIUS + 5.0, a[1] + 10.0
    others = np.delete(places, [source, to], axis=0)
    t = np.linspace(0.0, 1.0, 17)[:, None]
    controls, distances = [], []
    for bend in BENDS[1:] if bent else BENDS:
        # The middle of a quadratic curve is half way to its control point.
        control = (a + b) / 2 + 2 * bend * np.array([a[1] - b[1], b[0] - a[0]])
        points = (1 - t) ** 2 * a + 2 * t * (1 - t) * control + t**2 * b
        nearest = np.hypot(*(points[:, None] - others).T).min(initial=CLEARANCE)
        controls.append(control)
        distances.append(nearest)
    control = controls[int(np.argmax(distances))]
    start = a + (RADIUS + 2.0) * (control - a) / np.hypot(*(control - a))
    end = b + (RADIUS + 7.0) * (control - b) / np.hypot(*(control - b))  # room for the arrowhead
    return *start, *control, *end
