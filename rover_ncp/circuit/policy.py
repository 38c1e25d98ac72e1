"""A policy: a circuit with its sensing and motors, all that turns an observation into a command.

The parameter vector of a policy holds every number that a search may change, block after block in the order
of ``ParameterKind``. ``runner.py`` runs one policy; many at once run on ``compiled.py``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rover_ncp.circuit.circuit import BOUNDS, Circuit, FloatArray, ParameterKind, read_only
from rover_ncp.circuit.motors import Motors, course_motors, four_dof_motors, parking_motors
from rover_ncp.circuit.sensing import Sensing, course_sensing, parking_sensing
from rover_ncp.core.errors import ConfigError
from rover_ncp.course.course import Course


class ParameterBlock(NamedTuple):
    """The parameters of one kind: their slice of the vector and their bounds."""

    kind: ParameterKind
    slice: slice
    lower: float
    upper: float

    @property
    def size(self) -> int:
        """Number of parameters of this kind."""
        return int(self.slice.stop - self.slice.start)


@dataclass(frozen=True)
class ParameterLayout:
    """The blocks of a parameter vector (P,), in order and without gaps; kinds a policy lacks are absent."""

    blocks: tuple[ParameterBlock, ...]

    @property
    def size(self) -> int:
        """P, the number of parameters."""
        return int(self.blocks[-1].slice.stop)

    def block(self, kind: ParameterKind) -> ParameterBlock:
        """Return the block of a kind; raises KeyError when the policy has none."""
        for block in self.blocks:
            if block.kind == kind:
                return block
        raise KeyError(kind)

    @property
    def lower(self) -> FloatArray:
        """(P,) lower bounds."""
        return np.concatenate([np.full(block.size, block.lower) for block in self.blocks])

    @property
    def upper(self) -> FloatArray:
        """(P,) upper bounds."""
        return np.concatenate([np.full(block.size, block.upper) for block in self.blocks])


@dataclass(frozen=True, eq=False)
class Policy:
    """A circuit, its mappings and its time step. Raises ConfigError when the parts do not fit together."""

    circuit: Circuit
    sensing: Sensing
    motors: Motors
    input_layer: FloatArray | None = None
    """(channels, inputs): sensory channels = layer @ inputs. Without it each input is a channel."""
    output_layer: FloatArray | None = None
    """(outputs, channels): outputs = layer @ motor channels. Without it each channel is an output."""
    dt_s: float = 0.01
    substeps: int = 10
    courses: tuple[str, ...] = ()
    """Names of the courses it was trained on."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """How it was made: command, seed, settings, return, commit, package versions."""

    def __post_init__(self) -> None:
        for name in ("input_layer", "output_layer"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name), np.float64))
        problems = [
            *self._name_problems(),
            *_layer_problems("input_layer", self.input_layer, self._channels[0], self.sensing.inputs),
            *_layer_problems("output_layer", self.output_layer, self.motors.outputs, self._channels[1]),
        ]
        if self.input_layer is None and self.sensing.ranges is not None:
            problems.append("sensing.ranges: needs an input_layer; without one, channels have ranges")
        if self.output_layer is None and self.motors.limits is not None:
            problems.append("motors.limits: needs an output_layer; without one, channels have limits")
        if not 0 < self.dt_s <= 1:
            problems.append(f"dt_s: must be above 0 and at most 1 s, got {self.dt_s}")
        if not 1 <= self.substeps <= 10_000:
            problems.append(f"substeps: must be in 1..10000, got {self.substeps}")
        if problems:
            raise ConfigError(f"policy {self.circuit.name}", problems)

    @property
    def tick_s(self) -> float:
        """Time in s that one control tick advances the circuit."""
        return self.dt_s * self.substeps

    def layout(self) -> ParameterLayout:
        """Return the slice and bounds of each kind in the parameter vector."""
        blocks, start = [], 0
        for kind, values in self._arrays():
            block = slice(start, start + values.size)
            blocks.append(ParameterBlock(kind, block, BOUNDS[kind].lower, BOUNDS[kind].upper))
            start = block.stop
        return ParameterLayout(tuple(blocks))

    def parameters(self) -> FloatArray:
        """Return a copy of all parameters as one vector (P,)."""
        return np.concatenate([values.ravel() for _, values in self._arrays()])

    def with_parameters(self, vector: ArrayLike) -> "Policy":
        """Return this policy with other parameters (P,); raises ConfigError out of bounds or of length."""
        values = np.asarray(vector, np.float64)
        layout = self.layout()
        if values.shape != (layout.size,):
            raise ConfigError(
                f"policy {self.circuit.name}", [f"needs {layout.size} parameters, got {values.shape}"]
            )
        parts: dict[str, Any] = {str(block.kind): values[block.slice] for block in layout.blocks}
        layers: dict[str, Any] = {
            kind: parts.pop(kind).reshape(getattr(self, kind).shape)
            for kind in ("input_layer", "output_layer")
            if kind in parts
        }
        sigma = self.circuit.sigma.copy()
        sigma[self.circuit.chemical] = parts.pop("sigma", ())
        circuit = replace(self.circuit, sigma=sigma, **parts)
        return replace(self, circuit=circuit, **layers)

    @property
    def _channels(self) -> tuple[list[str], list[str]]:
        return [c.name for c in self.sensing.channels], [c.name for c in self.motors.channels]

    def _arrays(self) -> list[tuple[ParameterKind, FloatArray]]:
        circuit = self.circuit
        arrays = [
            (ParameterKind.WEIGHT, circuit.weight),
            (ParameterKind.SIGMA, circuit.sigma[circuit.chemical]),
            (ParameterKind.LEAK_POTENTIAL, circuit.leak_potential),
            (ParameterKind.LEAK, circuit.leak),
            (ParameterKind.CAPACITANCE, circuit.capacitance),
            (ParameterKind.INPUT_LAYER, self.input_layer),
            (ParameterKind.OUTPUT_LAYER, self.output_layer),
        ]
        return [(kind, values) for kind, values in arrays if values is not None and values.size]

    def _name_problems(self) -> list[str]:
        known = set(self.circuit.neurons)
        return [
            f"{what}.channels[{number}]: the circuit has no neuron {neuron!r}"
            for what, channels in (("sensing", self.sensing.channels), ("motors", self.motors.channels))
            for number, channel in enumerate(channels)
            for neuron, _ in channel.sides
            if neuron not in known
        ]


def _layer_problems(
    name: str, layer: FloatArray | None, rows: Sequence[str], columns: Sequence[str]
) -> list[str]:
    if layer is None:
        if list(rows) == list(columns):
            return []
        names = f"{', '.join(columns)} and {', '.join(rows)}"
        return [f"{name}: is missing, and without it these would have to be the same: {names}"]
    if layer.shape != (len(rows), len(columns)):
        return [f"{name}: needs {len(rows)} rows of {len(columns)} numbers, got the shape {layer.shape}"]
    bounds = BOUNDS[ParameterKind(name)]
    return [
        f"{name}[{row}][{column}]: {value:g} is outside {bounds}"
        for (row, column), value in np.ndenumerate(layer)
        if not bounds.lower <= value <= bounds.upper
    ]


def parking_policy(circuit: Circuit, clamp: bool = True) -> Policy:
    """Return a circuit with the paper's mappings for parking, also in reverse if it has the neuron REV.

    ``clamp=False`` is for circuits trained with the published code, which does not clamp its sensors.
    """
    motors = four_dof_motors() if "REV" in circuit.neurons else parking_motors()
    return Policy(circuit, parking_sensing(clamp), motors, courses=("parking",))


def absolute_policy(circuit: Circuit, course: Course) -> Policy:
    """Return a circuit with parking's mappings, the ranges of its sensors on the course's side."""
    poses = np.array([point.pose for point in course.checkpoints])
    downward = [
        name
        for name, values in zip(("x", "y", "theta"), poses.T, strict=True)
        if -values.min() > values.max()
    ]
    policy = parking_policy(circuit)
    return replace(policy, sensing=parking_sensing(downward=downward), courses=(course.name,))


def course_policy(circuit: Circuit) -> Policy:
    """Return a circuit with the sensing relative to a course, the neurons FWD and REV as the two tracks.

    In the initial layers the first pair of sensors carries the error along the course, the second the errors
    across it and in heading; REV above FWD turns left.
    """
    return Policy(
        circuit,
        course_sensing(),
        course_motors(),
        input_layer=np.array([[1.0, 0.0, 0.0, 0.6, 0.0], [0.0, 0.8, 1.0, 0.0, 0.6]]),
        output_layer=np.array([[0.5, 0.5], [-1.5, 1.5]]),
    )
