"""Parameters of a skid-steered rigid body and of the ground below it, and the ranges they are drawn from."""

import math
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field

from rover_ncp.core.config import StrictModel
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.robot.description import RobotDescription

ValueT = TypeVar("ValueT")


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"a range is [least, most], got [{ends[0]:g}, {ends[1]:g}]")
    return ends


Range = Annotated[tuple[ValueT, ValueT], AfterValidator(_rising)]
"""Least and greatest value of what is drawn."""
Friction = Annotated[float, Field(gt=0, le=5)]
Slope = Annotated[float, Field(ge=0, lt=0.5)]
Aside = Annotated[float, Field(ge=-0.2, le=0.2)]
PatchSize = Annotated[float, Field(ge=0.1, le=10)]


class Contact(StrictModel):
    """How the simulator resolves the contacts of tyres and ground."""

    step_s: float = Field(default=0.0025, gt=0, le=0.005, description="of the simulation")
    tyre_s: float = Field(default=0.02, gt=0, description="in which a tyre springs back; less is stiffer")
    stickiness: float = Field(default=1.0, gt=0, description="more: friction is full at less slip")


class Patches(StrictModel):
    """A checkerboard on the floor: every second square has another friction than the floor."""

    size_m: PatchSize = Field(description="side of a square, parallel to the axes of the course's frame")
    friction: Friction
    corner_m: tuple[float, float] = Field(default=(0.0, 0.0), description="lower left corner of a square")

    def under(self, x: float, y: float) -> bool:
        """Return whether a point lies on a square with the other friction."""
        column, row = ((at - corner) // self.size_m for at, corner in zip((x, y), self.corner_m, strict=True))
        return (column + row) % 2.0 == 0.0


class SkidRobot(StrictModel):
    """One robot and its ground, in SI units; by default a Pioneer 3-AT on a level floor."""

    mass_kg: float = Field(default=12.0, gt=0)
    wheel_mass_kg: float = Field(default=0.75, gt=0, description="each of the four, within the mass")
    mass_center_m: tuple[float, float] = Field(
        default=(0.0, 0.0), description="the whole robot's, ahead and to the left of its middle"
    )
    mass_height_m: float = Field(default=0.15, gt=0)
    friction: float = Field(default=0.7, gt=0, description="μ of the tyres in every direction")
    patches: Patches | None = Field(default=None, description="of the floor with another friction")
    half_track_m: float = Field(default=0.197, gt=0, description="from the middle to the wheels")
    half_wheelbase_m: float = Field(default=0.135, gt=0)
    nominal_half_track_m: float = Field(
        default=0.001 / 0.0034, gt=0, description="effective, of the firmware"
    )
    wheel_radius_m: float = Field(default=0.111, gt=0, description="as in the firmware")
    radius_factors: tuple[float, float, float, float] = Field(
        default=(1.0, 1.0, 1.0, 1.0), description="front left, front right, rear left, rear right"
    )
    torque_n_m: float = Field(default=10.0, gt=0, description="at most, of the motors of a side")
    slope_rad: float = Field(default=0.0, ge=0, lt=0.5)
    uphill_rad: float = Field(default=0.0, description="direction of the rise, in the course's frame")
    cables: tuple[tuple[float, float, float], ...] = Field(
        default=(), description="x, y in m and direction in rad of cables on the ground"
    )
    cable_height_m: float = Field(default=0.006, gt=0)
    height_m: float = Field(default=0.277, gt=0, description="of the shell's top; a ray looks below it")
    clearance_m: float = Field(default=0.06, gt=0, description="below the shell")
    contact: Contact = Contact()


class PatchRanges(StrictModel):
    """Ranges of ``Patches``. Where the board begins is drawn too."""

    size_m: Range[PatchSize] = Field(description="least and most")
    friction: Range[Friction] = Field(description="least and most, of every second square")


class SkidRanges(StrictModel):
    """Ranges of a ``SkidRobot``; ± unless stated otherwise. The defaults change nothing."""

    mass: float = Field(default=0.0, ge=0, lt=1, description="share")
    friction: Range[Friction] = Field(default=(0.7, 0.7), description="least and most")
    mass_center_m: float = Field(
        default=0.0, ge=0, lt=0.1, description="0..: distance from the middle, in any direction"
    )
    mass_left_m: Range[Aside] = Field(
        default=(0.0, 0.0), description="least and most, beside mass_center_m: further to the left"
    )
    wheel_radius: float = Field(default=0.0, ge=0, lt=0.1, description="share, each wheel")
    track: float = Field(default=0.0, ge=0, lt=1, description="share")
    slope_rad: Range[Slope] = Field(default=(0.0, 0.0), description="least and most, any direction")
    cables: int = Field(default=0, ge=0, le=100, description="on the ground near the start")
    cables_within_m: float = Field(
        default=1.0, gt=0, le=100, description="distance of their middles from the start"
    )
    patches: PatchRanges | None = Field(
        default=None, description="squares of the floor with another friction"
    )
    contact: Contact = Field(default=Contact(), description="not drawn")

    @property
    def varies(self) -> bool:
        """Whether the drawn robots differ."""
        shares = self.mass, self.mass_center_m, self.wheel_radius, self.track, self.cables, *self.slope_rad
        wide = any(least != most for least, most in (self.friction, self.mass_left_m))
        return any(shares) or wide or self.patches is not None


def rigid_body_of(robot: RobotDescription) -> SkidRobot:
    """Return a described robot with four wheels; what a description leaves out is that of a 3-AT, scaled."""
    usual = SkidRobot()
    heavier, larger = robot.mass_kg / usual.mass_kg, robot.wheels.radius_m / usual.wheel_radius_m
    higher = robot.height_m / usual.height_m
    return SkidRobot(
        mass_kg=robot.mass_kg,
        wheel_mass_kg=usual.wheel_mass_kg * heavier,
        mass_height_m=usual.mass_height_m * higher,
        half_track_m=robot.wheels.track_m / 2,
        half_wheelbase_m=robot.wheels.axles_m / 2,
        nominal_half_track_m=robot.track_m / 2,
        wheel_radius_m=robot.wheels.radius_m,
        torque_n_m=usual.torque_n_m * heavier * larger,
        height_m=robot.height_m,
        clearance_m=usual.clearance_m * larger,
    )


def draw_robot(ranges: SkidRanges, seed: int, number: int, usual: SkidRobot | None = None) -> SkidRobot:
    """Draw the robot and the ground of trial ``number`` of a seed, about a ``usual`` one."""
    stream = random_stream(seed, Domain.SKID_ROBOT, number)
    u = stream.uniform(-1.0, 1.0, 7).tolist()
    radii = stream.uniform(-1.0, 1.0, 4)
    places = stream.uniform(-1.0, 1.0, (ranges.cables, 3))
    usual = usual or SkidRobot()
    off, aside = ranges.mass_center_m * 0.5 * (1.0 + u[2]), math.pi * u[3]
    left = between(ranges.mass_left_m, random_stream(seed, Domain.MASS_LEFT, number).uniform(-1.0, 1.0))
    within = ranges.cables_within_m
    return usual.model_copy(
        update={
            "mass_kg": usual.mass_kg * (1.0 + ranges.mass * u[0]),
            "friction": between(ranges.friction, u[1]),
            "mass_center_m": (off * math.cos(aside), off * math.sin(aside) + left),
            "half_track_m": usual.half_track_m * (1.0 + ranges.track * u[4]),
            "radius_factors": tuple((1.0 + ranges.wheel_radius * radii).tolist()),
            "slope_rad": between(ranges.slope_rad, u[5]),
            "uphill_rad": math.pi * u[6],
            "cables": tuple((within * x, within * y, math.pi * turn) for x, y, turn in places.tolist()),
            "contact": ranges.contact,
            "patches": ranges.patches and _patches(ranges.patches, seed, number),
        }
    )


def _patches(ranges: PatchRanges, seed: int, number: int) -> Patches:
    u = random_stream(seed, Domain.PATCHES, number).uniform(-1.0, 1.0, 4).tolist()
    size = between(ranges.size_m, u[0])
    # The board repeats itself after two squares.
    return Patches(size_m=size, friction=between(ranges.friction, u[1]), corner_m=(size * u[2], size * u[3]))


def between(ends: tuple[float, float], u: float) -> float:
    """Return the value in a range for a draw in −1..1."""
    return ends[0] + (ends[1] - ends[0]) * 0.5 * (1.0 + u)
