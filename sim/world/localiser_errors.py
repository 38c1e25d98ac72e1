"""Errors of external poses that last: of one trial, and the ranges that they are drawn from.

A localiser's error is white noise and a first-order Gauss-Markov process. The process has the drawn standard
deviation at every moment, and forgets itself with the drawn time constant.
"""

import math
from typing import Annotated, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rover_ncp.core.config import StrictModel
from rover_ncp.core.geometry import Pose, wrap_angle
from rover_ncp.robot.lasting_error import LastingError
from sim.world.skid_robot import Range, between

FloatArray = NDArray[np.float64]
Metres = Annotated[float, Field(ge=0, le=1)]
Radians = Annotated[float, Field(ge=0, le=1)]
Seconds = Annotated[float, Field(gt=0, le=3600)]


class LocaliserRanges(StrictModel):
    """Ranges of the errors of external poses; each value is the standard deviation in x, y or heading."""

    noise_m: Metres | None = Field(default=None, description="white noise, by default the camera's own")
    noise_rad: Radians | None = Field(default=None, description="white noise of the heading, with noise_m")
    lasting_m: Range[Metres] = Field(default=(0.0, 0.0), description="least and most, of an error that lasts")
    lasting_rad: Range[Radians] = Field(default=(0.0, 0.0), description="least and most, of its heading")
    lasting_s: Range[Seconds] = Field(default=(5.0, 5.0), description="least and most time constant")
    told_m: Metres | None = Field(
        default=None, description="the lasting error by the messages' covariance, by default the drawn one"
    )
    told_rad: Radians | None = Field(default=None, description="of the heading, by default the drawn one")
    declared: LastingError | None = Field(default=None, description="by the source, by default as drawn")

    @model_validator(mode="after")
    def _both_or_neither(self) -> Self:
        if (self.noise_m is None) != (self.noise_rad is None):
            raise ValueError("noise_m and noise_rad go together: name both or neither")
        return self


class Measured(NamedTuple):
    """A measured pose and its covariance (x, y, heading)."""

    pose: Pose
    covariance: FloatArray


class LocaliserErrors:
    """Errors of one trial's localiser, drawn from ``ranges`` by a stream that nothing else uses."""

    def __init__(self, ranges: LocaliserRanges, stream: np.random.Generator) -> None:
        m, rad, s = stream.uniform(-1.0, 1.0, 3).tolist()
        self.lasting_s = between(ranges.lasting_s, s)
        self.lasting = _sigmas(between(ranges.lasting_m, m), between(ranges.lasting_rad, rad))
        told_m = self.lasting[0] if ranges.told_m is None else ranges.told_m
        told_rad = self.lasting[2] if ranges.told_rad is None else ranges.told_rad
        drawn = LastingError(position_m=self.lasting[0], heading_rad=self.lasting[2], time_s=self.lasting_s)
        self.declared = ranges.declared or (drawn if self.lasting.any() else None)
        """What the source declares; None for that of the camera without such errors."""
        self._told = np.diag(np.square(_sigmas(told_m, told_rad)))
        self._noise = None if ranges.noise_m is None else _sigmas(ranges.noise_m, ranges.noise_rad or 0.0)
        self._stream = stream
        self._error, self._time_s = np.zeros(3), -math.inf

    def apply(self, measured: Measured, true: Pose, now_s: float) -> Measured:
        """Return a pose measured at ``now_s``, which is later at each call, with these errors."""
        kept = math.exp((self._time_s - now_s) / self.lasting_s)
        new = self._stream.normal(size=(2, 3))
        self._error = kept * self._error + math.sqrt(1.0 - kept * kept) * self.lasting * new[0]
        self._time_s = now_s
        pose, covariance = measured
        if self._noise is not None:
            pose = Pose(*(np.array(true) + self._noise * new[1]).tolist())
            covariance = np.diag(np.square(self._noise))
        x, y, theta = (np.array(pose) + self._error).tolist()
        return Measured(Pose(x, y, wrap_angle(theta)), covariance + self._told)


def _sigmas(position_m: float, heading_rad: float) -> FloatArray:
    return np.array([position_m, position_m, heading_rad])
