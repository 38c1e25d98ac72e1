"""A policy as C99: from an observation to a command, and from the rover's pose on a course to an observation.

The templates write the solver's statements for one lane, in its order and with the numbers that a lane holds,
so that a build as double gives the solver's bits. Each neuron is written out: a wiring is short, and a reader
finds every neuron by its name. Speed and turn of the reference are constants at its knots, which a tick
integrates as ``course/reference.py`` does.
"""

import re
from importlib.metadata import version
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from rover_ncp.circuit.circuit import MIDPOINT_MV, RESTING_MV, FloatArray
from rover_ncp.circuit.compiled import GapJunctions, Synapses, make_circuits
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.reference import EXP2, INHIBITORY_MV
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.geometry import Pose
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.reference import KNOT_TICKS, Reference, plan_reference
from rover_ncp.course.signals import SIGNALS, TABLE, needs_reference, signals

CHECK_TICKS = 120
_POSE_SIGMAS = (0.1, 0.1, 0.2)
"""Standard deviation of the check's poses from the reference, m, m, rad: the sensors reach their ends."""
_FLOAT_TERMS = 8
"""Terms of the exponential as float: the next one is below 6e-9 of it, a tenth of a float's last bit."""


class Synapse(NamedTuple):
    """A synapse into a neuron, with the numbers of a lane; a gap junction has no slope."""

    source: int
    weight: float
    slope: float | None
    inhibitory: bool


def c_files(policy: Policy, name: str, course: Course) -> dict[str, str]:
    """Return the files ``NAME.h``, ``NAME.c`` and ``NAME_check.c``; ``name`` is a C identifier.

    A policy with inputs that are no signals of a rover has no functions for the course.
    """
    drives = set(policy.sensing.inputs) <= set(SIGNALS)
    reference = plan_reference(course) if needs_reference(policy.sensing.inputs) else None
    templates = Environment(
        loader=PackageLoader("rover_ncp.export"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    templates.filters |= {"real": _real, "comment": _comment}
    values = {
        "name": name,
        "NAME": name.upper(),
        "version": version("rover-ncp"),
        "policy": policy,
        "tick_s": TICK_S,
        "resting_mV": RESTING_MV,
        "midpoint_mV": MIDPOINT_MV,
        "inhibitory_mV": INHIBITORY_MV,
        "exponential": list(EXP2),
        "float_terms": _FLOAT_TERMS,
        "course": _course(policy, course, reference) if drives else None,
        **_circuit(policy),
        **_vectors(policy, course if drives else None, reference),
    }
    files = {f"{name}.h": "policy.h", f"{name}.c": "policy.c", f"{name}_check.c": "check.c"}
    return {file: templates.get_template(template).render(values) for file, template in files.items()}


def _real(value: float) -> str:
    """Return a number as C, exact as double; the macro R gives it the type."""
    return f"R({float(value)!r})"


def _comment(names: tuple[str, ...]) -> str:
    """Return names for a comment, which none of them can end."""
    return ", ".join(re.sub(r"[^\w .+-]", "_", name) for name in names)


def _circuit(policy: Policy) -> dict[str, Any]:
    program, lane, _ = make_circuits(policy, 1)
    inputs = program.input_layer_at.shape[1]
    sensors = [
        {
            "channel": channel,
            "layer": lane.input_layer[0, channel * inputs : (channel + 1) * inputs, 0].tolist(),
            "neurons": [row[:1] + row[2:] for row in rows],
        }
        for channel, rows in groupby(_rows(program.sensors), key=lambda row: row[1])
    ]
    weights = (
        (program.input_synapses, lane.input_weight, lane.input_slope),
        (program.input_gaps, lane.input_gap, None),
        (program.recurrent_synapses, lane.recurrent_weight, lane.recurrent_slope),
        (program.recurrent_gaps, lane.recurrent_gap, None),
    )
    integrated = []
    for d, neuron in enumerate(program.integrated.neuron.tolist()):
        chemical, gaps, recurrent, recurrent_gaps = (_into(d, *each) for each in weights)
        integrated.append(
            {
                "neuron": neuron,
                "current": lane.leak_current[0, d, 0],
                "conductance": lane.conductance[0, d, 0],
                "rate": lane.rate[0, d, 0],
                "inputs": chemical + gaps,
                "recurrent": recurrent + recurrent_gaps,
            }
        )
    outputs, channels = len(policy.motors.outputs), len(policy.motors.channels)
    layer = lane.output_layer[0, :, 0].reshape(-1, channels).tolist()
    limits = program.output_limit.tolist()
    return {
        "sensors": sensors,
        "integrated": integrated,
        "chemical": len(program.input_synapses.source) + len(program.recurrent_synapses.source) > 0,
        "motors": _rows(program.motors),
        "motor_low": program.motor_low,
        "motor_scale": program.motor_scale,
        "outputs": [(layer[o] if layer else None, limits[o] if limits else None) for o in range(outputs)],
    }


def _rows(columns: tuple[Any, ...]) -> list[tuple[Any, ...]]:
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _into(
    d: int, synapses: Synapses | GapJunctions, weight: FloatArray, slope: FloatArray | None
) -> list[Synapse]:
    """Return the synapses into an integrated neuron, excitatory ones first as in the solver."""
    return [
        Synapse(
            source=int(synapses.source[s]),
            weight=weight[0, s, 0],
            slope=None if slope is None else slope[0, s, 0],
            inhibitory=isinstance(synapses, Synapses) and bool(s >= synapses.first_inhibitory[d]),
        )
        for s in range(synapses.first[d], synapses.first[d + 1])
    ]


def _course(policy: Policy, course: Course, reference: Reference | None) -> dict[str, Any]:
    start_tick = next((k for k in range(course.ticks) if course.start_signal(k * TICK_S)), course.ticks)
    expressions = {signal.name: signal.c.format(start_tick=start_tick) for signal in TABLE}
    values = {
        "name": course.name,
        "ticks": course.ticks,
        "observation": [expressions[name] for name in policy.sensing.inputs],
        "reference": reference,
    }
    if reference is not None:
        knots = reference.motion[::KNOT_TICKS]
        values |= {
            "knot_ticks": KNOT_TICKS,
            "knots": {"v": knots[:, 0].tolist(), "omega": knots[:, 1].tolist()},
            "start": reference.poses[0].tolist(),
        }
    return values


def _vectors(policy: Policy, course: Course | None, reference: Reference | None) -> dict[str, Any]:
    """Return observations and the solver's commands for them, ticks in a row from rest.

    With a course they come from poses near it, without one from numbers in -1..1.
    """
    generator = random_stream(0, Domain.EXPORT_VECTORS)
    poses = None
    observations = generator.uniform(-1.0, 1.0, (CHECK_TICKS, len(policy.sensing.inputs)))
    if course is not None:
        poses = generator.normal(0.0, _POSE_SIGMAS, (CHECK_TICKS, 3))
        chosen = [SIGNALS.index(name) for name in policy.sensing.inputs]
        for k in range(CHECK_TICKS):
            tick = max(k - 1, 0)  # the first is the warm-up
            where = reference.tick(tick) if reference else None
            if where:
                poses[k, :2] += where[0][:2]
            start = 0.0 if k == 0 else course.start_signal(tick * TICK_S)
            observations[k] = np.array(signals(Pose(*poses[k].tolist()), start, where))[chosen]
    runner = Runner(policy)
    commands = [runner.tick(observation) for observation in observations]
    return {
        "poses": None if poses is None else poses.tolist(),
        "observations": observations.tolist(),
        "commands": commands,
    }
