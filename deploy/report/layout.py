"""Layout of a circuit's drawing, for pictures and pages.

Neurons stand in four rows: sensory, inter, command (what feeds a motor neuron) and motor. Within a row they
are ordered so that synapses cross little; a synapse is a quadratic curve, bent where a straight line would
run through another neuron. Coordinates: x to the right, y down, one row apart is `ROW`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy

FloatArray = NDArray[np.float64]

WIDTH, HEIGHT, ROW = 560.0, 600.0, 160.0
RADIUS = 30.0
"""Of a neuron."""
MARGIN = 60.0
BENDS = (0.0, 0.08, -0.08, 0.15, -0.15, 0.25, -0.25, 0.4, -0.4)
"""How far a curve's middle may lie beside the straight line, in lengths of the line."""
CLEAR = RADIUS + 12.0
"""Nearer to a neuron's centre, a foreign synapse would look like one of its own."""
SAMPLES = np.linspace(0.0, 1.0, 17)


class Layer(StrEnum):
    """The rows, from above."""

    SENSORY = "sensory"
    INTER = "inter"
    COMMAND = "command"
    MOTOR = "motor"


class Curve(NamedTuple):
    """A synapse from (x0, y0) to (x1, y1), both on the rims of their neurons, by way of a control point."""

    x0: float
    y0: float
    cx: float
    cy: float
    x1: float
    y1: float


@dataclass(frozen=True)
class Layout:
    """The drawing: a place for each neuron (n), a curve for each synapse (m)."""

    layers: tuple[Layer, ...]
    places: tuple[tuple[float, float], ...]
    curves: tuple[Curve, ...]


def layers(policy: Policy) -> tuple[Layer, ...]:
    """Return each neuron's layer."""
    circuit = policy.circuit
    motors = {neuron for channel in policy.motors.channels for neuron, _ in channel.sides}
    commands = {
        circuit.neurons[source]
        for source, destination in zip(circuit.source, circuit.destination, strict=True)
        if circuit.neurons[destination] in motors
    }
    return tuple(
        Layer.SENSORY
        if name in policy.sensing.neurons
        else Layer.MOTOR
        if name in motors
        else Layer.COMMAND
        if name in commands
        else Layer.INTER
        for name in circuit.neurons
    )


def labels(policy: Policy) -> dict[str, str]:
    """Return the inputs of sensory neurons and the outputs of motor neurons, as in ``omega > 0``."""
    return {
        neuron: channel.name if len(channel.sides) == 1 else f"{channel.name} {'>' if end > 0 else '<'} 0"
        for channel in (*policy.sensing.channels, *policy.motors.channels)
        for neuron, end in channel.sides
    }


def lay_out(policy: Policy) -> Layout:
    """Draw a policy's circuit. The same circuit gives the same drawing."""
    circuit, layer = policy.circuit, layers(policy)
    rows = [[i for i, own in enumerate(layer) if own is row] for row in Layer]
    edges = list(zip(circuit.source.tolist(), circuit.destination.tolist(), strict=True))
    places = _facing(policy, _placed(_ordered(rows, edges), circuit.size))
    return Layout(
        layers=layer,
        places=tuple((float(x), float(y)) for x, y in places),
        curves=tuple(_curves(places, edges)),
    )


def _facing(policy: Policy, places: FloatArray) -> FloatArray:
    """Of a drawing and its mirror image take the one whose positive motor neuron, as for left, is left."""
    for channel in policy.motors.channels:
        if channel.positive is not None and channel.negative is not None:
            positive, negative = (
                places[policy.circuit.index(name), 0] for name in (channel.positive, channel.negative)
            )
            if positive > negative:
                return places * [-1, 1] + [WIDTH, 0]
    return places


def _placed(rows: Sequence[Sequence[int]], size: int) -> FloatArray:
    places = np.zeros((size, 2))
    for number, row in enumerate(rows):
        # Rows of different lengths interleave, so that a synapse across a row finds a gap.
        gap = (WIDTH - 2 * MARGIN) / max(len(row) - 1, 1)
        gap = min(gap, 190.0)
        start = WIDTH / 2 - gap * (len(row) - 1) / 2
        for place, neuron in enumerate(row):
            places[neuron] = start + gap * place, MARGIN + ROW * number
    return places


def _ordered(rows: list[list[int]], edges: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Order each row in turn for the least cost of straight lines, until nothing improves."""
    size = sum(map(len, rows))
    best = _cost(_placed(rows, size), edges)
    improved = True
    while improved:
        improved = False
        for number, row in enumerate(rows):
            for order in _orders(row):
                tried = [*rows[:number], order, *rows[number + 1 :]]
                cost = _cost(_placed(tried, size), edges)
                if cost < best - 1e-9:
                    rows, best, improved = tried, cost, True
    return rows


def _orders(row: Sequence[int]) -> Iterator[list[int]]:
    """Yield orders to try: all of a short row, else every exchange of two."""
    if len(row) <= 5:
        yield from map(list, permutations(row))
        return
    for i in range(len(row)):
        for j in range(i):
            order = list(row)
            order[i], order[j] = order[j], order[i]
            yield order


def _cost(places: FloatArray, edges: Sequence[tuple[int, int]]) -> float:
    """Return how bad straight lines look: their lengths, crossings and neurons in the way."""
    if not edges:
        return 0.0
    source, destination = np.array(edges).T
    a, b = places[source], places[destination]
    lengths = np.hypot(*(b - a).T)
    crossings = 0
    d = b - a
    for i in range(len(edges)):
        c, e = a[i + 1 :], b[i + 1 :]
        one = _side(a[i], d[i], c) * _side(a[i], d[i], e) < 0
        other = _side(c, d[i + 1 :], a[i]) * _side(c, d[i + 1 :], b[i]) < 0
        crossings += int(np.sum(one & other))
    covered = sum(_crowding(places, ends, _sampled(places[ends[0]], places[ends[1]], 0.0)) for ends in edges)
    return float(lengths.sum() / ROW + 2.0 * crossings + covered)


def _side(start: FloatArray, along: FloatArray, point: FloatArray) -> FloatArray:
    offset = point - start
    side: FloatArray = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    return side


def _sampled(a: FloatArray, b: FloatArray, bend: float) -> FloatArray:
    control = _control(a, b, bend)
    t = SAMPLES[:, None]
    points: FloatArray = (1 - t) ** 2 * a + 2 * t * (1 - t) * control + t**2 * b
    return points


def _control(a: FloatArray, b: FloatArray, bend: float) -> FloatArray:
    # The middle of a quadratic curve lies half way to its control point.
    control: FloatArray = (a + b) / 2 + 2 * bend * np.array([a[1] - b[1], b[0] - a[0]])
    return control


def _crowding(places: FloatArray, ends: tuple[int, int], points: FloatArray) -> float:
    """Return how deep a curve runs into neurons that are not its own, and beyond the margins."""
    others = np.array([p for i, p in enumerate(places) if i not in ends])
    if not len(others):
        return 0.0
    nearest = np.hypot(*(points[:, None] - others[None]).transpose(2, 0, 1)).min(axis=0)
    inside = np.clip(CLEAR - nearest, 0, None).sum() / CLEAR
    outside = np.clip([-points.min(), points[:, 0].max() - WIDTH], 0, None).sum() / RADIUS
    return float(8.0 * inside + 4.0 * outside)


def _curves(places: FloatArray, edges: Sequence[tuple[int, int]]) -> Iterator[Curve]:
    """Bend each synapse as little as it takes to keep clear of other neurons and of earlier synapses."""
    drawn: list[FloatArray] = []
    for ends in edges:
        a, b = places[ends[0]], places[ends[1]]
        if ends[0] == ends[1]:
            yield _loop(a)
            continue
        costs = []
        for bend in BENDS:
            points = _sampled(a, b, bend)
            # Two synapses between the same neurons, or along the same way, must not lie on each other.
            inner = points[3:-3]
            shared = sum(
                np.mean(np.hypot(*(inner[:, None] - other[None]).transpose(2, 0, 1)).min(axis=1) < 9.0) ** 2
                for other in drawn
            )
            costs.append(_crowding(places, ends, points) + 8.0 * shared + 4.0 * abs(bend))
        bend = BENDS[int(np.argmin(costs))]
        drawn.append(_sampled(a, b, bend)[3:-3])
        yield _trimmed(a, b, _control(a, b, bend))


def _trimmed(a: FloatArray, b: FloatArray, control: FloatArray) -> Curve:
    """Return the part of a curve outside of its own neurons."""
    start = a + (RADIUS + 2.0) * (control - a) / np.hypot(*(control - a))
    end = b + (RADIUS + 7.0) * (control - b) / np.hypot(*(control - b))  # room for the arrow's head
    return Curve(*map(float, (*start, *control, *end)))


def _loop(a: FloatArray) -> Curve:
    """Return a synapse of a neuron on itself, beside it."""
    x, y = a
    return Curve(x + RADIUS, y - 8.0, x + 2.6 * RADIUS, y, x + RADIUS + 5.0, y + 10.0)
