"""How a policy is connected to a rover: the signals that it observes, and the motion that its outputs make.

A *signal* is a number that a policy may name as an input. Nine are built in (``course/reference.py``). A
*motion* makes v in m/s and omega in rad/s of a policy's outputs. One is built in: the outputs ``v`` and
``omega`` themselves. Python may declare more; the parameters of a function name what it takes:

    @signal
    def far(longitudinal: float, lateral: float) -> float:
        \"\"\"Distance to the reference, m.\"\"\"
        return math.hypot(longitudinal, lateral)

    @motion
    def bend(v: float, curvature: float) -> tuple[float, float]:
        \"\"\"Speed in m/s and curvature in 1/m.\"\"\"
        return v, v * curvature

A policy with the input ``far`` or the outputs ``v, curvature`` then drives. numba compiles the functions, for
the simulator as for the robot, so both get the same bits. A package declares them with an entry point of the
group ``rover_ncp.extensions`` that names their module; it is imported when a policy names something unknown.
"""

import inspect
import math
from collections.abc import Callable, Sequence
from functools import cache
from importlib import metadata
from typing import Any, NamedTuple, TypeVar

from rover_ncp.circuit.policy import Policy
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.course import TICK_S
from rover_ncp.course.reference import SIGNALS, needs_reference, see

GROUP = "rover_ncp.extensions"

Function = TypeVar("Function", bound=Callable[..., Any])


class Declared(NamedTuple):
    """A declared signal or motion."""

    function: Callable[..., Any]
    takes: tuple[str, ...]


_signals: dict[str, Declared] = {}
_motions: dict[tuple[str, ...], Declared] = {}


def signal(function: Function) -> Function:
    """Declare a signal: a function of built-in signals, which its parameters name; both have one name.

    Raises ConfigError for a parameter that is no built-in signal, and for a name that is taken.
    """
    name, takes = function.__name__, tuple(inspect.signature(function).parameters)
    problems = [
        f"{part!r} is no built-in signal ({', '.join(SIGNALS)})" for part in takes if part not in SIGNALS
    ]
    if not takes:
        problems.append("a signal takes at least one built-in signal")
    if name in SIGNALS:
        problems.append("there is a built-in signal of that name")
    _declare(_signals, name, Declared(function, takes), f"signal {name}", problems)
    return function


def motion(function: Function) -> Function:
    """Declare a motion: a function of outputs, which its parameters name, that returns v and omega.

    Raises ConfigError for parameters that are taken.
    """
    takes = tuple(inspect.signature(function).parameters)
    problems = ["it needs at least one output"] if not takes else []
    if takes == Velocity._fields:
        problems.append("v and omega are built in")
    _declare(_motions, takes, Declared(function, takes), f"motion {function.__name__}", problems)
    return function


def _declare(table: dict[Any, Declared], key: Any, new: Declared, what: str, problems: list[str]) -> None:
    old = table.get(key)
    # A module that a worker process or a reload imports again declares the same once more.
    if old is not None and old.function.__qualname__ != new.function.__qualname__:
        problems.append(f"{old.function.__qualname__} of {old.function.__module__} is declared so already")
    if problems:
        raise ConfigError(what, problems)
    table[key] = new


class Input(NamedTuple):
    """One input of a policy: a built-in signal, or a compiled function of some."""

    compute: Any
    """Kernel of as many numbers as there are places; None for a built-in signal."""
    places: tuple[int, ...]
    """Of the signals in the order of ``SIGNALS``."""


class RoverInterface:
    """A policy's connection to a rover. Raises ConfigError for a policy that drives none."""

    def __init__(self, policy: Policy) -> None:
        names, outputs = policy.sensing.inputs, policy.motors.outputs
        problems = []
        if unknown := [name for name in names if name not in SIGNALS and _found(_signals, name) is None]:
            known = ", ".join([*SIGNALS, *_signals])
            problems.append(f"its sensing asks for {', '.join(unknown)}; known are {known}")
        if outputs != Velocity._fields and _found(_motions, outputs) is None:
            known = " or ".join([", ".join(Velocity._fields), *(", ".join(takes) for takes in _motions)])
            problems.append(f"its outputs are {', '.join(outputs)}; expected {known}")
        if not math.isclose(policy.tick_s, TICK_S):
            problems.append(f"its tick lasts {policy.tick_s:g} s; a control tick lasts {TICK_S} s")
        if problems:
            raise ConfigError(f"policy {policy.circuit.name}", problems)
        self.inputs = tuple(_input(name) for name in names)
        self.motion = declared_motion(policy)
        """Kernel of the outputs that returns v and omega; None for outputs that are v and omega."""
        self.needs_reference = needs_reference(
            tuple(SIGNALS[place] for one in self.inputs for place in one.places)
        )

    @property
    def built_in(self) -> bool:
        """Whether inputs and outputs are all built in."""
        return self.motion is None and all(one.compute is None for one in self.inputs)

    def observe(self, pose: Pose, start: float, reference: tuple[Pose, Velocity] | None) -> list[float]:
        """Return the observation (inputs,) at a pose; ``start`` is the start signal."""
        seen = see(pose, start, reference)
        return [
            seen[one.places[0]] if one.compute is None else one.compute(*(seen[i] for i in one.places))
            for one in self.inputs
        ]

    def command(self, outputs: Sequence[float]) -> Velocity:
        """Return v in m/s and omega in rad/s for a policy's outputs."""
        return Velocity(*(outputs if self.motion is None else self.motion(*outputs)))


def declared_motion(policy: Policy) -> Any:
    """Return the kernel that makes v and omega of a policy's outputs; None where no motion is declared."""
    outputs = policy.motors.outputs
    declared = None if outputs == Velocity._fields else _found(_motions, outputs)
    return None if declared is None else _compiled(declared.function, len(outputs), 2)


def _found(table: dict[Any, Declared], key: Any) -> Declared | None:
    if key not in table:
        _load_extensions()
    return table.get(key)


@cache
def _load_extensions() -> None:
    """Import the modules that installed packages name. Raises ConfigError for one that fails."""
    for point in metadata.entry_points(group=GROUP):
        try:
            point.load()
        except ConfigError:
            raise
        except Exception as error:
            problem = f"it cannot be imported: {type(error).__name__}: {error}"
            raise ConfigError(f"extension {point.value}", [problem]) from error


def _input(name: str) -> Input:
    if name in SIGNALS:
        return Input(None, (SIGNALS.index(name),))
    declared = _signals[name]
    places = tuple(SIGNALS.index(part) for part in declared.takes)
    return Input(_compiled(declared.function, len(places), 1), places)


@cache
def _compiled(function: Callable[..., Any], takes: int, gives: int) -> Any:
    """Return the kernel of a declared function. Raises ConfigError if it cannot be one."""
    # Only here, so that policies can be read and judged where numba is not installed.
    from numba.core.errors import NumbaError

    from rover_ncp.kernels.jit import kernel

    compiled = kernel(function)
    try:
        found = compiled(*[0.0] * takes)
    except NumbaError as error:
        raise ConfigError(function.__name__, [f"numba cannot compile it: {str(error).strip()}"]) from error
    if not (isinstance(found, float) if gives == 1 else isinstance(found, tuple) and len(found) == gives):
        expected = "a float" if gives == 1 else f"{gives} floats"
        raise ConfigError(function.__name__, [f"it must return {expected}, got {type(found).__name__}"])
    return compiled
