"""The mapping of an observation to the potentials of sensory neurons (supplement eq. 1-2).

A channel x with range [x_min, x_max] sets its positive neuron to -70 + 50 x / x_max and its negative neuron
to -70 + 50 x / x_min, in mV, where x counts from the channel's origin. Clamped, both stay within -70..-20
mV. Unclamped, as in the published code (and so for circuits trained with it), a single neuron follows its
line up to ±1000 mV. Of an unclamped pair the neuron of x's sign does, and the other stays at -70 mV.
"""

from collections.abc import Collection, Sequence
from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.core.config import StrictModel
from rover_ncp.native.core import Axes

LOW_MV = -70.0
HIGH_MV = -20.0
SATURATION_MV = 1000.0
"""An unclamped potential ends at plus or minus this: twenty times its range, and no overflow."""


class Channel(StrictModel):
    """One variable and the neurons it drives, one for its positive values, one for its negative, or both."""

    name: str = Field(min_length=1)
    """The input or output that it carries, without a linear layer; with one, any name."""
    positive: str | None = None
    """Neuron of the values above 0."""
    maximum: float | None = Field(default=None, gt=0)
    """Distance above the origin at which that neuron is at the upper end of its range."""
    negative: str | None = None
    """Neuron of the values below 0."""
    minimum: float | None = Field(default=None, lt=0)
    """Distance from the origin, below it, at which that neuron is at the upper end of its range."""
    origin: float | None = None
    """Sensors only: the value, if not 0, at which its neurons are at the lower end, and its range begins."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.positive is None) != (self.maximum is None):
            raise ValueError("a positive neuron and a maximum go together")
        if (self.negative is None) != (self.minimum is None):
            raise ValueError("a negative neuron and a minimum go together")
        if self.positive is None and self.negative is None:
            raise ValueError("needs a positive or a negative neuron")
        return self

    @property
    def sides(self) -> list[tuple[str, float]]:
        """The neurons with the end of their range."""
        both = ((self.positive, self.maximum), (self.negative, self.minimum))
        return [(neuron, end) for neuron, end in both if neuron is not None and end is not None]


class SensorMap(NamedTuple):
    """Sensory neurons as arrays (s,): potential = clip(base + gain * channel, lower, upper), in mV."""

    neuron: Annotated[NDArray[np.int64], Axes("sensors", below="neurons")]
    channel: Annotated[NDArray[np.int64], Axes("sensors", below="channels|inputs")]
    base: Annotated[NDArray[np.float64], Axes("sensors")]
    gain: Annotated[NDArray[np.float64], Axes("sensors")]
    lower: Annotated[NDArray[np.float64], Axes("sensors")]
    upper: Annotated[NDArray[np.float64], Axes("sensors")]


class Sensing(StrictModel):
    """The whole mapping: named inputs, and the channels that they are, or that a linear layer makes of them.

    Without a layer the channels carry the inputs' names, in the same order. With one, an input may be
    given a range: what it is divided by before the layer, so that entries of the layer compare.
    """

    name: str = Field(min_length=1)
    """Name of the mapping, for messages."""
    inputs: tuple[str, ...] = Field(min_length=1)
    ranges: tuple[Annotated[float, Field(gt=0)], ...] | None = None
    """By input, with an input layer: the layer gets the input divided by this."""
    clamp: bool = True
    channels: tuple[Channel, ...] = Field(min_length=1)
    """With the sensory neurons that each drives."""

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        neurons = [neuron for channel in self.channels for neuron, _ in channel.sides]
        for what, names in (
            ("input", self.inputs),
            ("channel", [channel.name for channel in self.channels]),
            ("sensory neuron", neurons),
        ):
            require_distinct(what, names)
        if self.ranges is not None and len(self.ranges) != len(self.inputs):
            raise ValueError(f"needs as many ranges as inputs, got {len(self.ranges)}")
        return self

    @property
    def neurons(self) -> tuple[str, ...]:
        """The sensory neurons in the order of ``map_onto``."""
        return tuple(neuron for channel in self.channels for neuron, _ in channel.sides)

    def map_onto(self, circuit: Circuit) -> SensorMap:
        """Return the mapping as arrays for a circuit; raises ConfigError when it lacks a neuron."""
        rows = []
        for number, channel in enumerate(self.channels):
            pair = len(channel.sides) == 2
            for neuron, end in channel.sides:
                lower = LOW_MV if self.clamp or pair else -SATURATION_MV
                upper = HIGH_MV if self.clamp else SATURATION_MV
                gain = (HIGH_MV - LOW_MV) / end
                base = LOW_MV - gain * (channel.origin or 0.0)
                rows.append((circuit.index(neuron), number, base, gain, lower, upper))
        columns = list(zip(*rows, strict=True))
        return SensorMap(
            np.array(columns[0], np.int64),
            np.array(columns[1], np.int64),
            *(np.array(column, np.float64) for column in columns[2:]),
        )


def require_distinct(what: str, names: Sequence[str]) -> None:
    """Raise ValueError when a name appears twice."""
    for name in names:
        if list(names).count(name) > 1:
            raise ValueError(f"{what} {name!r} appears twice")


def parking_sensing(clamp: bool = True, downward: Collection[str] = ()) -> Sensing:
    """Return the paper's sensing for parking: the estimated pose and the start signal, each on one neuron.

    Ranges are 0 to 1, or 0 to -1 for inputs that go ``downward``, on a course to the other side.
    """
    table = (("x", "PVD"), ("y", "PLM"), ("theta", "ALM"), ("start", "AVM"))
    return Sensing(
        name="absolute",
        inputs=tuple(name for name, _ in table),
        clamp=clamp,
        channels=tuple(
            Channel(name=name, negative=neuron, minimum=-1.0)
            if name in downward
            else Channel(name=name, positive=neuron, maximum=1.0)
            for name, neuron in table
        ),
    )


def course_sensing() -> Sensing:
    """Return the sensing relative to a course: two mixtures of five signals, each on a pair of touch neurons.

    The pairs are those of the paper's benchmarks (PLM and AVM, ALM and PVD, each ±1). A range is a large
    value on the way: 0.2 m, 0.4 rad, and the motors' speeds.
    """
    return Sensing(
        name="course",
        inputs=("longitudinal", "lateral", "heading", "speed", "turn"),
        ranges=(0.2, 0.2, 0.4, 0.16, 0.18),
        channels=(
            Channel(name="first", positive="PLM", maximum=1.0, negative="AVM", minimum=-1.0),
            Channel(name="second", positive="ALM", maximum=1.0, negative="PVD", minimum=-1.0),
        ),
    )
