"""The mapping of the potentials of motor neurons to commands (supplement eq. 3).

A channel is y = y_p + y_n. The positive neuron's potential, from ``low_mV`` to ``high_mV``, gives y_p from 0
to the maximum, the negative neuron's gives y_n from 0 to the minimum; beyond that range they stay at its
end. The paper's text has -70..-20 mV, its code (and so every published circuit) -60..-20 mV.
"""

from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rover_ncp.circuit.circuit import Circuit
from rover_ncp.circuit.sensing import Channel, require_distinct
from rover_ncp.core.config import StrictModel
from rover_ncp.course.reference import COMMAND_MAX
from rover_ncp.native.core import Axes


class MotorMap(NamedTuple):
    """Motor neurons as arrays (q,): channel += end * clip((potential - low) / (high - low), 0, 1)."""

    neuron: Annotated[NDArray[np.int64], Axes("motors", below="neurons")]
    channel: Annotated[NDArray[np.int64], Axes("motors", below="motor_channels")]
    end: Annotated[NDArray[np.float64], Axes("motors")]


class Motors(StrictModel):
    """The whole mapping: channels, and the named outputs that they are, or that a linear layer makes of them.

    Without a layer the channels carry the outputs' names, in the same order. A neuron may drive several
    channels. With a layer, outputs may have limits: the layer then gives an output as a share of its limit,
    and no output exceeds it.
    """

    outputs: tuple[str, ...] = Field(min_length=1)
    limits: tuple[Annotated[float, Field(gt=0)], ...] | None = None
    """By output, with an output layer: its largest value."""
    low_mV: float = Field(default=-60.0, ge=-90, le=0)
    high_mV: float = Field(default=-20.0, ge=-90, le=0)
    channels: tuple[Channel, ...] = Field(min_length=1)
    """With the motor neurons that drive each."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.low_mV < self.high_mV:
            raise ValueError(f"low_mV must be below high_mV, got {self.low_mV} and {self.high_mV}")
        if self.limits is not None and len(self.limits) != len(self.outputs):
            raise ValueError(f"needs as many limits as outputs, got {len(self.limits)}")
        if any(channel.origin is not None for channel in self.channels):
            raise ValueError("a motor channel has no origin")
        require_distinct("output", self.outputs)
        require_distinct("channel", [channel.name for channel in self.channels])
        return self

    def map_from(self, circuit: Circuit) -> MotorMap:
        """Return the mapping as arrays for a circuit; raises ConfigError when it lacks a neuron."""
        rows = [
            (circuit.index(neuron), number, end)
            for number, channel in enumerate(self.channels)
            for neuron, end in channel.sides
        ]
        neuron, channel, end = zip(*rows, strict=True)
        return MotorMap(np.array(neuron, np.int64), np.array(channel, np.int64), np.array(end, np.float64))


def parking_motors() -> Motors:
    """Return the paper's motors for parking: forward speed in m/s, turn rate in rad/s (left positive)."""
    return _steered(Channel(name="v", positive="FWD", maximum=0.16))


def four_dof_motors() -> Motors:
    """Return the motors for parking forward and in reverse; the paper calls them four degrees of freedom."""
    return _steered(Channel(name="v", positive="FWD", maximum=0.16, negative="REV", minimum=-0.16))


def _steered(v: Channel) -> Motors:
    omega = Channel(name="omega", positive="LFT", maximum=0.18, negative="RGT", minimum=-0.18)
    return Motors(outputs=("v", "omega"), channels=(v, omega))


def course_motors() -> Motors:
    """Return the motors of the paper's half-cheetah, mixed into speed (m/s) and rate of turn (rad/s).

    The limits leave room above a reference's motion to catch up with it, and lie below those of the gate.
    """
    return Motors(
        outputs=("v", "omega"),
        limits=(COMMAND_MAX.v, COMMAND_MAX.omega),
        channels=(
            # Named as in the paper's wiring; both drive forward, each to the side away from its track.
            Channel(name="left_track", positive="FWD", maximum=1.0),
            Channel(name="right_track", positive="REV", maximum=1.0),
        ),
    )
