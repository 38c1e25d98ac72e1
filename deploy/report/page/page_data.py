"""Data of a page as plain values for its script: one drawing, and columns over time.

Columns are rounded to what a screen can show: a page of a drive of 32 s stays well under a megabyte without
its plotting library.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deploy.report.analysis import Analysis
from deploy.report.charts.shapes import OUTLINE, ellipse, rectangle
from deploy.report.charts.style import ring_radius
from deploy.report.currents import synapse_currents
from deploy.report.layout import HEIGHT, RADIUS, WIDTH, labels, lay_out
from deploy.report.published import CONTRIBUTIONS
from deploy.report.timeline import Command, Moved, Tick, Timeline
from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course

TRUTH_STEP_NS = 50_000_000
"""A mock writes the true pose at 100 Hz; a picture needs no more than 20."""


def course_data(course: Course) -> dict[str, Any]:
    """Return a course and the rover's outline."""
    return {
        "name": course.name,
        "checkpoints": [[p.t, p.x, p.y, p.theta] for p in course.checkpoints],
        "obstacles": [
            _rounded(rectangle(o.length, o.width, (o.x, o.y, o.theta)).ravel()) for o in course.obstacles
        ],
        "goal": [course.goal.x, course.goal.y, course.parked.position_m],
        "startSignal": course.start_signal_s,
        "horizon": course.horizon_s,
        "outline": OUTLINE.tolist(),
    }


def circuit_data(policy: Policy) -> dict[str, Any]:
    """Return a circuit as it is drawn."""
    circuit, layout = policy.circuit, lay_out(policy)
    meanings = labels(policy)
    return {
        "name": circuit.name,
        "size": [WIDTH, HEIGHT, RADIUS],
        "neurons": [
            {
                "name": name,
                "layer": str(layer),
                "x": round(x, 1),
                "y": round(y, 1),
                "label": meanings.get(name, ""),
            }
            for name, layer, (x, y) in zip(circuit.neurons, layout.layers, layout.places, strict=True)
        ],
        "synapses": [
            {
                "kind": SynapseKind(kind).name.lower(),
                "source": int(source),
                "destination": int(destination),
                "curve": _rounded(curve, 1),
            }
            for kind, source, destination, curve in zip(
                circuit.kind, circuit.source, circuit.destination, layout.curves, strict=True
            )
        ],
    }


def frames(timeline: Timeline, ticks: Sequence[Tick]) -> dict[str, Any]:
    """Return columns over some of a drive's ticks; times in s since its first tick."""
    if not ticks:
        return {}
    potentials = np.array([tick.potentials for tick in ticks])
    currents = synapse_currents(timeline.policy.circuit, potentials)
    poses = np.array([tick.estimate.pose for tick in ticks])
    ellipses = [ellipse(tick.estimate.covariance[:2, :2]) for tick in ticks]
    return {
        "t": _since(timeline, (tick.wall_ns for tick in ticks)),
        "x": _rounded(poses[:, 0], 4),
        "y": _rounded(poses[:, 1], 4),
        "theta": _rounded(poses[:, 2], 4),
        "ellipse": [_rounded(one, 6) for one in ellipses],
        "potentials": [_rounded(column, 2) for column in potentials.T],
        "currents": [_rounded(column, 3) for column in currents.current.T],
        "pulls": [_rounded(column, 2) for column in currents.pull.T],
    }


def moved_columns(timeline: Timeline, rows: Sequence[Moved], on_course: bool) -> dict[str, Any]:
    """Return poses over time; ``on_course`` lays odometry onto the course."""
    poses = [timeline.on_course(row.pose) if on_course else row.pose for row in rows]
    known = [(row, pose) for row, pose in zip(rows, poses, strict=True) if pose is not None]
    return {
        "t": _since(timeline, (row.wall_ns for row, _ in known)),
        "x": _rounded([pose.x for _, pose in known], 4),
        "y": _rounded([pose.y for _, pose in known], 4),
        "theta": _rounded([pose.theta for _, pose in known], 4),
        "v": _rounded([row.velocity.v if row.velocity else 0.0 for row, _ in known], 4),
        "omega": _rounded([row.velocity.omega if row.velocity else 0.0 for row, _ in known], 4),
    }


def command_columns(timeline: Timeline, rows: Sequence[Command]) -> dict[str, Any]:
    """Return commands over time."""
    return {
        "t": _since(timeline, (row.wall_ns for row in rows)),
        "v": _rounded([row.velocity.v for row in rows], 4),
        "omega": _rounded([row.velocity.omega for row in rows], 4),
    }


def event_rows(timeline: Timeline) -> list[dict[str, Any]]:
    """Return the events with their times."""
    began = timeline.began_ns
    if began is None:
        return []
    return [
        {"t": round((event.wall_ns - began) * 1e-9, 2), "kind": event.kind, "text": event.text}
        for event in timeline.events
    ]


def drive_data(timeline: Timeline) -> dict[str, Any]:
    """Return everything over time of a whole drive."""
    thinned: list[Moved] = []
    for moved in timeline.truth:
        if not thinned or moved.wall_ns - thinned[-1].wall_ns >= TRUTH_STEP_NS:
            thinned.append(moved)
    return {
        "ticks": frames(timeline, timeline.ticks),
        "odometry": moved_columns(timeline, timeline.odometry, on_course=True),
        "truth": moved_columns(timeline, thinned, on_course=False),
        "asked": command_columns(timeline, timeline.asked),
        "letThrough": command_columns(timeline, timeline.let_through),
        "events": event_rows(timeline),
    }


def findings(analysis: Analysis) -> dict[str, Any]:
    """Return the findings of a run: phases, contributions, time constants."""
    return {
        "phases": [
            {
                "label": each.phase.label,
                "start": round(each.phase.start_s, 2),
                "end": round(each.phase.end_s, 2),
                "text": each.text,
                "neurons": [level.neuron for level in (each.behind, each.motor) if level is not None],
            }
            for each in analysis.explanations
        ],
        "rings": {
            row.neuron: [round(ring_radius(row.lowest_s), 1), round(ring_radius(row.highest_s), 1)]
            for row in analysis.time_constants
        },
        "timeConstants": [[row.neuron, row.lowest_s, row.highest_s] for row in analysis.time_constants],
        "sources": analysis.sources,
        "motors": analysis.motors,
        "contributions": {
            f"{a} {b}": [str(one.sign), one.positive, one.negative, one.flat, list(one.bins)]
            for (a, b), one in analysis.contributions.items()
        },
        "driving": {
            f"{a} {b}": [str(one.sign), one.positive, one.negative]
            for (a, b), one in analysis.driving.items()
        },
        "paper": {f"{a} {b}": str(sign) for (a, b), sign in CONTRIBUTIONS.items()},
    }


def _since(timeline: Timeline, moments: Iterable[int]) -> list[float]:
    began = timeline.began_ns
    assert began is not None  # nothing has a time before the first tick
    return [round((moment - began) * 1e-9, 3) for moment in moments]


def _rounded(values: ArrayLike, digits: int = 4) -> list[float | None]:
    """Return numbers for JSON: rounded, and None for a value that is not finite."""
    return [
        round(value, digits) if math.isfinite(value) else None
        for value in np.asarray(values, np.float64).tolist()
    ]
