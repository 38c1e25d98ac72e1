"""All C files of a policy, and test vectors for the check among them: what the solver answers."""

from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from rover_ncp.circuit.circuit import FloatArray
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.geometry import Pose
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.signals import SIGNALS, needs_reference, signals
from rover_ncp.export.circuit_c import circuit_files, fill, literal
from rover_ncp.export.course_c import course_files

TICKS = 120
_FAR = (0.1, 0.1, 0.2)
"""Standard deviation of the poses from the reference, m, m, rad: the sensors reach their ends."""
FLOAT_TOLERANCE = 1e-4


class Vectors(NamedTuple):
    """T ticks in a row from rest."""

    poses: FloatArray | None
    """(T, 3) m, m, rad; None for a policy whose inputs no course gives."""
    observations: FloatArray
    """(T, inputs)."""
    commands: FloatArray
    """(T, outputs)."""
    potentials: FloatArray
    """(T, n) mV, after each tick."""


def c_files(policy: Policy, name: str, course: Course) -> dict[str, str]:
    """Return the text of each C file; ``name`` is a C identifier."""
    reference = plan_reference(course) if needs_reference(policy.sensing.inputs) else None
    made_by = version("rover-ncp")
    files = circuit_files(policy, name, made_by)
    if drives(policy):
        files |= course_files(policy, course, reference, name, made_by)
    return files | {f"{name}_check.c": check_file(make_vectors(policy, course, reference), name)}


def drives(policy: Policy) -> bool:
    """Whether a course gives all that a policy observes."""
    return set(policy.sensing.inputs) <= set(SIGNALS)


def make_vectors(policy: Policy, course: Course, reference: Reference | None) -> Vectors:
    """Run a policy on random observations: poses near the course, or numbers in -1..1 without one."""
    generator = random_stream(0, Domain.EXPORT_VECTORS)
    poses = None
    observations = generator.uniform(-1.0, 1.0, (TICKS, len(policy.sensing.inputs)))
    if drives(policy):
        poses = generator.normal(0.0, _FAR, (TICKS, 3))
        chosen = [SIGNALS.index(name) for name in policy.sensing.inputs]
        for k in range(TICKS):
            tick = max(k - 1, 0)  # the first is the warm-up
            where = reference.tick(tick) if reference else None
            if where:
                poses[k, :2] += where[0][:2]
            signal = 0.0 if k == 0 else course.start_signal(tick * TICK_S)
            values = signals(Pose(*poses[k].tolist()), signal, where)
            observations[k] = [values[i] for i in chosen]
    runner = Runner(policy)
    commands, potentials = [], []
    for observation in observations:
        commands.append(runner.tick(observation))
        potentials.append(runner.potentials)
    return Vectors(poses, observations, np.array(commands), np.array(potentials))


def check_file(vectors: Vectors, name: str) -> str:
    """Return ``NAME_check.c``, a program that compares a build with the vectors."""
    sources, header = [f"{name}_check.c", f"{name}.c"], f"{name}.h"
    poses = start = see_it = ""
    if vectors.poses is not None:
        sources.append(f"{name}_course.c")
        header = f"{name}_course.h"
        poses = f"static const real poses[TICKS][3] = {{\n{_rows(vectors.poses)}\n}};"
        start = (
            f"    {name}_course course;\n    real seen[{name.upper()}_INPUTS];\n\n"
            f"    {name}_course_start(&course);"
        )
        see_it = (
            f"        {name}_observe(&course, poses[k][0], poses[k][1], poses[k][2], seen);\n"
            f"        seen_apart = apart(seen_apart, seen, observations[k], {name.upper()}_INPUTS);\n"
            f"        {name}_course_advance(&course);"
        )
    return fill(
        "check.c",
        name=name,
        guard=name.upper(),
        sources=" ".join(sources),
        header=header,
        float_tolerance=repr(FLOAT_TOLERANCE),
        tick_count=len(vectors.observations),
        poses=poses,
        observations=_rows(vectors.observations),
        commands=_rows(vectors.commands),
        start=start,
        see=see_it,
    )


def _rows(table: FloatArray) -> str:
    return "\n".join("    {" + ", ".join(literal(value) for value in row) + "}," for row in table)
