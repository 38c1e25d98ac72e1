"""A course as C99: from the rover's pose to the observation that a policy expects at each tick.

The reference is not planned there: its speed and turn at the knots are constants, and a tick integrates them
as ``course/reference.py`` does.
"""

import math

import numpy as np
from numpy.typing import NDArray

from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.reference import KNOT_TICKS, Reference
from rover_ncp.course.signals import TABLE
from rover_ncp.export.circuit_c import fill, literal

_FIELDS = ("x", "y", "theta", "v", "omega")


def course_files(
    policy: Policy, course: Course, reference: Reference | None, name: str, version: str
) -> dict[str, str]:
    """Return the files ``NAME_course.h`` and ``NAME_course.c``; ``reference`` if it is seen."""
    common = {"name": name, "title": policy.circuit.name, "course": course.name}
    fields = "".join(f" {field}," for field in _FIELDS).rstrip(",")
    header = fill(
        "course.h",
        guard=name.upper(),
        version=version,
        ticks=course.ticks,
        tick_s=f"{TICK_S:g}",
        fields_are="; the reference at its start in m, rad (not wrapped), m/s and rad/s" if reference else "",
        fields=f"\n    {name}_real{fields};" if reference else "",
        **common,
    )
    start_tick = next((k for k in range(course.ticks) if course.start_signal(k * TICK_S)), course.ticks)
    expressions = {signal.name: signal.c.format(start_tick=start_tick) for signal in TABLE}
    observation = "\n".join(
        f"    observation[{i}] = {expressions[name]};" for i, name in enumerate(policy.sensing.inputs)
    )
    if reference is None:
        source = fill("course_absolute.c", observation=observation, **common)
    else:
        source = _with_reference(reference, observation, common)
    return {f"{name}_course.h": header, f"{name}_course.c": source}


def _with_reference(reference: Reference, observation: str, common: dict[str, str]) -> str:
    knots = reference.motion[::KNOT_TICKS]
    x, y, theta = reference.poses[0]
    return fill(
        "course.c",
        observation=observation,
        knot_ticks=KNOT_TICKS,
        knots_v=_rows(knots[:, 0]),
        knots_omega=_rows(knots[:, 1]),
        reference_ticks=reference.ticks,
        last_knot=len(knots) - 1,
        tick_s=repr(TICK_S),
        tau=repr(math.tau),
        pi=repr(math.pi),
        x=repr(float(x)),
        y=repr(float(y)),
        theta=repr(float(theta)),
        **common,
    )


def _rows(values: NDArray[np.float64]) -> str:
    """Return constants of C, eight a line."""
    rows = [values[i : i + 8] for i in range(0, len(values), 8)]
    return "\n".join("    " + ", ".join(literal(value) for value in row) + "," for row in rows)
