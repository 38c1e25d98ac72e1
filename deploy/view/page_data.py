"""Data of a page as plain values for its script: the course, the circuit's drawing, and columns over time.

Columns are rounded to screen precision, so the page of a drive of 32 s stays far below a megabyte without its
plotting library.
"""

import math
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deploy.view.timeline import Command, Moved, Tick, Timeline
from rover_ncp.circuit.circuit import SynapseKind
from rover_ncp.circuit.policy import Policy
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import Course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.shapes import OUTLINE, FloatArray, at_places, rectangle
from rover_ncp.neurons.interpretation import TimeConstant
from rover_ncp.neurons.layout import HEIGHT, RADIUS, WIDTH, label_lines, labels, lay_out, name_lines
from rover_ncp.neurons.trace import Trace, synapse_currents

REFERENCE_EVERY = 5
"""Ticks between points of the reference."""
LOW_MV, HIGH_MV = -90.0, 0.0
"""Range of all potentials, for colours and levels."""
TRUTH_STEP_NS = 50_000_000
"""A mock records the true pose at 100 Hz; a page shows 20 Hz."""
PICTURE_BYTES = 12_000_000
"""Most bytes of a page's pictures as JPEG: the page then has up to 18 MB. Of more, every second one is shown,
or every third, and so on."""
PICTURES_FROM_S = -2.0
"""Pictures from so long before the first tick on."""
MIN_RING = 1.5
"""Width of the ring of a constant time constant."""
RINGS_FROM_S, RING_PER_DECADE = 1e-4, 6.0


def course_data(course: Course, outline: FloatArray = OUTLINE) -> dict[str, Any]:
    """Return a course, its reference every half a second and the rover's outline."""
    return {
        "reference": plan_reference(course).poses[::REFERENCE_EVERY, :2].T.round(4).tolist(),
        "checkpoints": [[p.t, p.x, p.y, p.theta] for p in course.checkpoints],
        "deadlines": at_places([(p.x, p.y, p.t) for p in course.checkpoints]),
        "obstacles": [
            rectangle(o.length, o.width, (o.x, o.y, o.theta)).round(4).tolist() for o in course.obstacles
        ],
        "goal": [course.goal.x, course.goal.y, course.parked.position_m],
        "horizon": course.horizon_s,
        "outline": outline.round(4).tolist(),
    }


def circuit_data(policy: Policy) -> dict[str, Any]:
    """Return a circuit as it is drawn."""
    circuit, layout, meanings = policy.circuit, lay_out(policy), labels(policy)
    return {
        "outputs": _outputs(policy),
        "size": [WIDTH, HEIGHT, RADIUS],
        "neurons": [
            {
                "name": name,
                "layer": layer,
                "x": round(x, 1),
                "y": round(y, 1),
                "label": meanings.get(name, ""),
                "nameLines": name_lines(name),
                "lines": label_lines(meanings.get(name, "")),
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


def _outputs(policy: Policy) -> list[tuple[str, str]]:
    """Return the column and the axis title of each output."""
    names = policy.motors.outputs
    if names == Velocity._fields:
        return [("v", "v (m/s)"), ("omega", "ω (rad/s)")]
    return [(f"output{number}", name) for number, name in enumerate(names)]


def rings(policy: Policy, ranges: Sequence[TimeConstant]) -> list[tuple[str, float, float, float, float]]:
    """Return the rings of the time constants: neuron, x and y of the centre, inner radius and width."""
    places = dict(zip(policy.circuit.neurons, lay_out(policy).places, strict=True))
    found = []
    for row in ranges:
        inner, outer = (
            RADIUS + 4.0 + RING_PER_DECADE * math.log10(max(tau_s, RINGS_FROM_S) / RINGS_FROM_S)
            for tau_s in (row.lowest_s, row.highest_s)
        )
        found.append((row.neuron, *places[row.neuron], inner, max(outer - inner, MIN_RING)))
    return found


def columns(
    timeline: Timeline, first: Mapping[str, int], end: Mapping[str, int] | None = None
) -> dict[str, dict[str, Any]]:
    """Return all streams over time, each from a row on: columns with times in s since the first tick.

    ``end`` are the rows behind the last ones, by default all.
    """
    new = {
        name: rows[first[name] : len(rows) if end is None else end[name]]
        for name, rows in timeline.streams.items()
    }
    truth = {row.wall_ns // TRUTH_STEP_NS: row for row in new["truth"]}
    return {
        "ticks": _ticks(timeline, new["ticks"]),
        "odometry": _moved(timeline, new["odometry"], timeline.on_course),
        "truth": _moved(timeline, list(truth.values()), lambda pose: pose),
        "commands": _commands(timeline, new["commands"]),
        "setpoints": _commands(timeline, new["setpoints"]),
    }


def pictures(timeline: Timeline) -> list[dict[str, Any]]:
    """Return the pictures of a localiser's camera, as JPEG in base64, each with its time."""
    times = _since(timeline, [moment for moment, _ in timeline.pictures])
    found = [(t, jpeg) for t, (_, jpeg) in zip(times, timeline.pictures, strict=True) if t >= PICTURES_FROM_S]
    every = max(1, math.ceil(sum(len(jpeg) for _, jpeg in found) / PICTURE_BYTES))
    return [{"t": t, "jpeg": b64encode(jpeg).decode()} for t, jpeg in found[::every]]


def trace_columns(trace: Trace) -> dict[str, dict[str, Any]]:
    """Return a run without messages as columns over time; only a drive has a path."""
    times = _rounded(trace.times, 3)
    keys = [key for key, _ in _outputs(trace.policy)]
    outputs = dict(zip(keys, map(_rounded, trace.commands.T), strict=True))
    path = dict(zip(Pose._fields, map(_rounded, trace.poses[:-1].T), strict=True))
    return {
        "ticks": {"t": times, **path, **_activity(trace.policy, trace.potentials)},
        "commands": {"t": times, **outputs},
    }


def event_rows(timeline: Timeline) -> list[dict[str, Any]]:
    """Return the events with their times."""
    if timeline.began_ns is None:
        return []
    events = timeline.events
    times = _since(timeline, [event.wall_ns for event in events])
    return [{"t": t, "kind": event.kind, "text": event.text} for t, event in zip(times, events, strict=True)]


def _ticks(timeline: Timeline, ticks: Sequence[Tick]) -> dict[str, Any]:
    if not ticks:
        return {}
    potentials = np.array([tick.potentials for tick in ticks])
    x, y, theta = np.array([tick.estimate.pose for tick in ticks]).T
    activity = _activity(timeline.policy, potentials, timeline.staging, [tick.staged for tick in ticks])
    if timeline.other:
        unknown = [[None] * len(ticks)] * timeline.policy.circuit.synapse_count
        activity |= {"currents": unknown, "pulls": unknown}
    return {
        "t": _since(timeline, [tick.wall_ns for tick in ticks]),
        "x": _rounded(x),
        "y": _rounded(y),
        "theta": _rounded(theta),
        "ellipse": [_rounded(_ellipse(tick.estimate.covariance[:2, :2]), 6) for tick in ticks],
        **activity,
    }


def _activity(
    policy: Policy, potentials: FloatArray, staging: Policy | None = None, staged: Sequence[bool] = ()
) -> dict[str, Any]:
    """Return potentials, currents and pulls; those of ``staged`` ticks are of the ``staging`` policy.

    If that has other synapses than the page, its currents are left out.
    """
    found = synapse_currents(policy.circuit, potentials)
    current, pull = found.current, found.pull
    if staging is not None and any(staged):
        rows, same = np.array(staged), _same_synapses(policy, staging)
        other = synapse_currents(staging.circuit, potentials[rows]) if same else None
        current[rows] = math.nan if other is None else other.current
        pull[rows] = math.nan if other is None else other.pull
    return {
        "potentials": [_rounded(column, 2) for column in potentials.T],
        "currents": [_rounded(column, 3) for column in current.T],
        "pulls": [_rounded(column, 2) for column in pull.T],
    }


def _same_synapses(a: Policy, b: Policy) -> bool:
    return all(
        np.array_equal(getattr(a.circuit, name), getattr(b.circuit, name))
        for name in ("kind", "source", "destination")
    )


def _moved(
    timeline: Timeline, rows: Sequence[Moved], on_course: Callable[[Pose], Pose | None]
) -> dict[str, Any]:
    known = [(row, pose) for row in rows if (pose := on_course(row.pose)) is not None]
    return {
        **_commands(timeline, [Command(row.wall_ns, row.velocity) for row, _ in known]),
        **{name: _rounded([getattr(pose, name) for _, pose in known]) for name in Pose._fields},
    }


def _commands(timeline: Timeline, rows: Sequence[Command]) -> dict[str, Any]:
    return {
        "t": _since(timeline, [row.wall_ns for row in rows]),
        "v": _rounded([row.velocity.v for row in rows]),
        "omega": _rounded([row.velocity.omega for row in rows]),
    }


def _ellipse(covariance: FloatArray) -> tuple[float, float, float]:
    """Return half axes and direction of the ellipse of one standard deviation of a 2 x 2 covariance."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    major, minor = np.sqrt(np.clip(values[::-1], 0.0, None))
    return major, minor, np.arctan2(vectors[1, 1], vectors[0, 1])


def _since(timeline: Timeline, times_ns: Iterable[int]) -> list[float]:
    return [round((time - timeline.ticks[0].wall_ns) * 1e-9, 3) for time in times_ns]


def _rounded(values: ArrayLike, digits: int = 4) -> list[float | None]:
    """Return numbers for JSON: rounded, and None for a value that is not finite."""
    return [
        round(value, digits) if math.isfinite(value) else None
        for value in np.asarray(values, np.float64).tolist()
    ]
