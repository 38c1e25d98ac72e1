"""The error of a source of external poses that lasts for seconds, such as that of a map or of a mount.

A filter takes the noise of its measurements as independent in time, so that a hundred poses make it ten times
as certain. The lasting error of a localiser does not average out. It is modelled as a first-order
Gauss-Markov process: its standard deviation stays, and it is forgotten with the time constant (Gelb, Applied
Optimal Estimation, 1974, section 2.2). The covariance in a message says nothing about time.
"""

from enum import StrEnum
from typing import NamedTuple, Self

from pydantic import Field, model_validator

from rover_ncp.core.config import StrictModel


class Kind(StrEnum):
    """Kind of the source of poses, which gives what its declaration leaves out."""

    MOTION_CAPTURE = "motion-capture"
    """Cameras around the room, with millimetres."""
    TAGS = "tags"
    """A camera that sees tags at known places, as of `rover-ncp tag run`."""
    UNKNOWN = "unknown"
    """Anything that declares nothing: values of a particle filter on a laser map."""


class Lasting(NamedTuple):
    """Standard deviations of the lasting error in x and in y (m) and of the heading (rad), and its time."""

    position_m: float
    heading_rad: float
    time_s: float


BY_KIND = {
    Kind.MOTION_CAPTURE: Lasting(0.002, 0.002, 10.0),
    Kind.TAGS: Lasting(0.003, 0.005, 10.0),
    Kind.UNKNOWN: Lasting(0.08, 0.05, 20.0),
}
"""Chosen, and pessimistic for an unknown source: a rover that trusts it is never certain at 10 cm."""


class LastingError(StrictModel):
    """The lasting error that a source of poses declares; values that are left out are those of its kind."""

    kind: Kind = Field(default=Kind.UNKNOWN, description="kind of the source")
    position_m: float | None = Field(
        default=None, ge=0, le=10, description="standard deviation in x and in y"
    )
    heading_rad: float | None = Field(default=None, ge=0, le=1, description="standard deviation")
    time_s: float | None = Field(default=None, ge=0.1, le=1e5, description="time constant")

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        given = [value is not None for value in (self.position_m, self.heading_rad, self.time_s)]
        if self.kind is Kind.UNKNOWN and any(given) and not all(given):
            raise ValueError("without a kind it needs all of position_m, heading_rad and time_s")
        return self

    @property
    def declared(self) -> bool:
        """Whether the source says how long its errors last."""
        return self.kind is not Kind.UNKNOWN or self.time_s is not None

    @property
    def values(self) -> Lasting:
        """The declared values, completed by those of the kind."""
        usual = BY_KIND[self.kind]
        given = self.position_m, self.heading_rad, self.time_s
        return Lasting(*(own if value is None else value for value, own in zip(given, usual, strict=True)))

    def at_least(self, position_m: float, heading_rad: float) -> Self:
        """Return the same error, or a larger one with at least these standard deviations."""
        values = self.values
        if position_m <= values.position_m and heading_rad <= values.heading_rad:
            return self
        larger = {
            "position_m": max(position_m, values.position_m),
            "heading_rad": max(heading_rad, values.heading_rad),
            "time_s": values.time_s,
        }
        return self.model_copy(update=larger)


class Declaration(LastingError):
    """What a source of external poses declares of them on ``rover/localiser``."""

    frame: str = Field(default="", description="frame_id of its poses; empty: of all that have no other")


NOT_DECLARED = "how long the errors of the external poses last is not declared (lasting_error)"
"""Message for a source that declares nothing."""
UNDECLARED = LastingError()
"""Of a source that declares nothing."""
