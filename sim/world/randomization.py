"""Randomization of trials: perturbations of rover, odometry and commands, drawn before the trial.

A trial has random streams of its own, from the root seed and its number: one for the robot, and one for each
value that changes from tick to tick. A longer course continues these streams. So trial 7 of seed 1 is the
same perturbed robot for every driver, every course and every set of trials. Harder presets stretch the same
draws. Parameters are uniform in their ranges; noise is Gaussian.
"""

import math
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rover_ncp.core.config import StrictModel, load_yaml
from rover_ncp.core.errors import UsageError
from rover_ncp.core.files import resolve
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.course.course import TICK_S
from rover_ncp.native.core import Axes
from rover_ncp.robot.profile import RoverProfile
from sim.world.bodies import PRESETS, Body
from sim.world.localiser_errors import LocaliserRanges
from sim.world.rover import SUBSTEP_S, RoverModel
from sim.world.skid_robot import Range, SkidRanges

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


Sensors = Literal["encoders", "gyro", "camera"]
"""Sources of the observed pose: encoders; encoders and a gyro's turn; or the true pose with noise."""


Delay = Annotated[float, Field(ge=0, le=2)]
TurnGain = Annotated[float, Field(ge=0.2, le=5)]
Speed = Annotated[float, Field(ge=0, le=0.5)]
TurnRate = Annotated[float, Field(ge=0, le=2)]

_OF_PYMUNK = {
    "turn_gain": "the ground makes its turn gain",
    "rotation_center_m": "its weight (skid_steer.mass_center_m) makes its centre of rotation",
    "speed_step_m_s": "the mock's firmware makes the steps",
    "turn_step_rad_s": "the mock's firmware makes the steps",
    "sensors": "--sensors names the driver's",
}
"""Keys without effect on the body mujoco, and why."""


class Randomization(StrictModel):
    """Ranges of deviations from the model; ± unless stated otherwise. The defaults change nothing."""

    format: Literal[1] = 1
    name: str = Field(min_length=1, description="of these ranges, for messages and results")
    body: Body = Field(default=Body.PYMUNK, description="the simulator of the rover")
    skid_steer: SkidRanges | None = Field(default=None, description="of the body mujoco, and only there")
    start_m: float = Field(default=0.0, ge=0, le=1, description="start in x and in y, known to the rover")
    start_rad: float = Field(default=0.0, ge=0, le=math.pi, description="start heading, known to the rover")
    delay_v_s: Range[Delay] | None = Field(default=None, description="least and most, not the model's")
    delay_omega_s: Range[Delay] | None = Field(default=None, description="least and most for turn commands")
    acceleration: float = Field(default=0.0, ge=0, lt=1, description="share, forward and turning")
    gain: float = Field(default=0.0, ge=0, lt=1, description="share of speed and of turn rate")
    odometry_scale: float = Field(default=0.0, ge=0, lt=1, description="share, in distance and in heading")
    noise_m: float = Field(default=0.0, ge=0, le=1, description="standard deviation of an observed x and y")
    noise_rad: float = Field(default=0.0, ge=0, le=1, description="standard deviation of an observed heading")
    lost: float = Field(default=0.0, ge=0, lt=1, description="share of commands that do not arrive")
    burst: float = Field(default=1.0, ge=1, le=1000, description="mean number of commands lost in a row")
    wheel_mismatch_rad_m: float = Field(
        default=0.0, ge=0, le=1, description="wheel mismatch: turn per metre that no encoder measures"
    )
    slip_s: float = Field(
        default=0.0, ge=0, le=0.5, description="0..: lost share of a turn per rad/s, unseen"
    )
    speed_step_m_s: float = Field(default=0.0, ge=0, le=0.5, description="commands come in whole steps")
    turn_step_rad_s: float = Field(default=0.0, ge=0, le=2, description="turn commands come in whole steps")
    jitter_s: float = Field(default=0.0, ge=0, le=TICK_S, description="0..: age of an observed pose")
    drift_rad_s: float = Field(default=0.0, ge=0, le=1, description="of the observed heading")
    bump_m: float = Field(default=0.0, ge=0, le=1, description="one push on the way, unseen")
    bump_rad: float = Field(default=0.0, ge=0, le=math.pi, description="turn of that push")
    turn_gain: Range[TurnGain] | None = Field(default=None, description="least and most; of the wheels' turn")
    rotation_center_m: float = Field(default=0.0, ge=0, le=0.5, description="behind the middle, or ahead")
    dead_band_m_s: Range[Speed] | None = Field(
        default=None, description="least and most; smaller speed commands are not followed"
    )
    dead_band_rad_s: Range[TurnRate] | None = Field(
        default=None, description="least and most; smaller turn commands are not followed"
    )
    banded: float = Field(default=1.0, ge=0, le=1, description="share of robots with dead bands")
    sensors: Sensors = Field(default="encoders", description="of the observed pose, but for the stack")
    localiser: LocaliserRanges | None = Field(
        default=None, description="errors of the stack's external poses"
    )
    rover: RoverProfile | None = Field(default=None, description="what is known, and so not drawn")

    @model_validator(mode="after")
    def _fits_its_body(self) -> Self:
        if (self.skid_steer is not None) != (self.body is Body.MUJOCO):
            raise ValueError("a randomization has the key skid_steer if its body is mujoco, and only then")
        unread = [key for key in _OF_PYMUNK if key in self.model_fields_set]
        if self.body is Body.MUJOCO and unread:
            raise ValueError(
                f"remove {unread[0]}, which the body mujoco does not use: {_OF_PYMUNK[unread[0]]}"
            )
        return self

    @property
    def varies(self) -> bool:
        """Whether trials differ. A profile adds its noise; its other values are not taken into account."""
        known = self.rover.model_dump(include={"noise_m", "noise_rad"}) if self.rover else {}
        drawn = self.model_dump(exclude=_NOT_DRAWN)
        drawn |= {name: noise for name, noise in known.items() if noise is not None}
        skid = self.skid_steer is not None and self.skid_steer.varies
        return skid or 0.0 < self.banded < 1.0 or any(_is_wide(value) for value in drawn.values())


_NOT_DRAWN = {
    *("format", "name", "body", "skid_steer", "burst", "speed_step_m_s", "turn_step_rad_s", "banded"),
    *("sensors", "localiser", "rover"),
}
"""Keys of a randomization that are not ranges of a value drawn for each trial."""


def _is_wide(value: float | tuple[float, float] | None) -> bool:
    """Whether a range has more than one value."""
    return value[0] != value[1] if isinstance(value, tuple) else bool(value)


class Trials(NamedTuple):
    """N trials of up to T ticks as arrays."""

    exact: bool
    """Whether the policy observes the true pose, without odometry, noise and age."""
    sensors: tuple[bool, bool]
    """Whether sensors measure the true turn, and the true pose."""
    start: Annotated[FloatArray, Axes("trials", 3)]
    """Pose in the course's frame."""
    acceleration: Annotated[FloatArray, Axes("trials", 4)]
    """Factors on the limits accel, alpha, decel and alpha_decel."""
    delay: Annotated[IntArray, Axes("trials", 2, below="10*ticks_kept")]
    """Substeps."""
    gain: Annotated[FloatArray, Axes("trials", 2)]
    """Of v and omega."""
    odometry: Annotated[FloatArray, Axes("trials", 2)]
    """Scales of distance and heading."""
    wheel_mismatch: Annotated[FloatArray, Axes("trials")]
    slip: Annotated[FloatArray, Axes("trials")]
    drift: Annotated[FloatArray, Axes("trials")]
    turning: Annotated[FloatArray, Axes("trials", 2)]
    """Turn gain, and the centre of rotation in m."""
    bump: Annotated[FloatArray, Axes("trials", 4)]
    """The share of the drive's ticks after which it comes, then x, y, theta in m and rad."""
    noise: Annotated[FloatArray, Axes("trials", "trial_ticks+1", 3)]
    """What is added to the pose seen at the start of each tick."""
    age: Annotated[FloatArray, Axes("trials", "trial_ticks+1")]
    """Share of a tick by which that pose is old."""
    lost: Annotated[NDArray[np.bool_], Axes("trials", "trial_ticks")]
    """Whether the command of a tick is lost."""
    step: Annotated[FloatArray, Axes(2)]
    """Of v and omega; 0 for none."""
    motors: Annotated[FloatArray, Axes("trials", 6)]
    """Dead band of v and of omega, least wheel speed, speed of a slower wheel, half the track, stiction."""

    @property
    def size(self) -> int:
        """N."""
        return len(self.start)


def load_randomization(name_or_path: str | Path, body: Body = Body.PYMUNK) -> Randomization:
    """Load shipped ranges by name or a file by path. Raises UsageError if they are for another body."""
    ranges = load_yaml(resolve("randomizations", name_or_path), Randomization)
    if ranges.body != body:
        raise UsageError(
            f"randomization {name_or_path} is for the body {ranges.body}, expected one for {body}: "
            f"{', '.join(PRESETS[body])}, or a YAML file"
        )
    return ranges


def nominal_trials(model: RoverModel, ticks: int, count: int = 1) -> Trials:
    """Return trials in which everything is as the model says."""
    return draw_trials(Randomization(name="none"), model, 0, count=count, ticks=ticks)


def draw_trials(
    ranges: Randomization, model: RoverModel, seed: int, *, count: int, ticks: int, first: int = 0
) -> Trials:
    """Draw trials ``first``, ``first`` + 1, ... of a seed, each for ``ticks`` ticks or fewer."""
    if ranges.rover is not None:
        return _of_known(ranges, ranges.rover, model, seed, count=count, ticks=ticks, first=first)
    numbers = range(first, first + count)

    def streams(domain: Domain) -> list[np.random.Generator]:
        return [random_stream(seed, domain, number) for number in numbers]

    # (N, 23) in −1..1. A new value is drawn after the others, so that they stay.
    u = np.array([stream.uniform(-1.0, 1.0, 23) for stream in streams(Domain.TRIAL)])
    noise = np.array([stream.normal(size=(ticks + 1, 3)) for stream in streams(Domain.TRIAL_NOISE)])
    losses = np.array([stream.random(ticks) for stream in streams(Domain.TRIAL_LOSSES)])
    ages = np.array([stream.random(ticks + 1) for stream in streams(Domain.TRIAL_AGES)])
    nominal = (model.delay_v_s, model.delay_v_s), (model.delay_omega_s, model.delay_omega_s)
    least, most = np.array([ranges.delay_v_s or nominal[0], ranges.delay_omega_s or nominal[1]]).T
    delay_s = least + (most - least) * 0.5 * (1.0 + u[:, 3:5])
    least_gain, most_gain = ranges.turn_gain or (model.turn_gain, model.turn_gain)
    sigma = np.array([ranges.noise_m, ranges.noise_m, ranges.noise_rad])
    push = np.array([ranges.bump_m, ranges.bump_m, ranges.bump_rad])
    return Trials(
        exact=not (
            ranges.odometry_scale
            or ranges.drift_rad_s
            or ranges.wheel_mismatch_rad_m
            or ranges.slip_s
            or ranges.bump_m
            or ranges.bump_rad
            or ranges.jitter_s
            or ranges.turn_gain
            or ranges.rotation_center_m
            or sigma.any()
        ),
        sensors=(ranges.sensors != "encoders", ranges.sensors == "camera"),
        start=u[:, 0:3] * np.array([ranges.start_m, ranges.start_m, ranges.start_rad]),
        acceleration=np.tile(1.0 + ranges.acceleration * u[:, 5:7], 2),
        delay=np.rint(delay_s / SUBSTEP_S).astype(np.int64),
        gain=1.0 + ranges.gain * u[:, 7:9],
        odometry=1.0 + ranges.odometry_scale * u[:, 9:11],
        wheel_mismatch=ranges.wheel_mismatch_rad_m * u[:, 11],
        slip=ranges.slip_s * 0.5 * (1.0 + u[:, 12]),
        drift=ranges.drift_rad_s * u[:, 13],
        # On the way: in the second quarter of the time, which on our courses is spent driving.
        bump=np.column_stack([0.125 * (3.0 + u[:, 17]), push * u[:, 14:17]]),
        noise=sigma * noise,
        age=ranges.jitter_s / TICK_S * ages,
        lost=_lost(ranges, losses),
        step=np.array([ranges.speed_step_m_s, ranges.turn_step_rad_s]),
        turning=np.column_stack(
            [
                least_gain + (most_gain - least_gain) * 0.5 * (1.0 + u[:, 18]),
                model.rotation_center_m + ranges.rotation_center_m * u[:, 19],
            ]
        ),
        motors=_motors(ranges, model, u[:, 20:23]),
    )


def _motors(ranges: Randomization, model: RoverModel, u: FloatArray) -> FloatArray:
    """Return ``Trials.motors`` of draws (N, 3) in −1..1."""
    named = (ranges.dead_band_m_s, model.dead_band_v), (ranges.dead_band_rad_s, model.dead_band_omega)
    least, most = np.array([given or (own, own) for given, own in named]).T
    bands = least + (most - least) * 0.5 * (1.0 + u[:, :2])
    bands[0.5 * (1.0 + u[:, 2]) >= ranges.banded] = 0.0
    slow = model.wheel_min if model.slow_wheels_turn else 0.0
    own = np.array([model.wheel_min, slow, model.half_track_m, model.stiction])
    return np.hstack([bands, np.tile(own, (len(u), 1))])


def _of_known(
    ranges: Randomization,
    known: RoverProfile,
    model: RoverModel,
    seed: int,
    *,
    count: int,
    ticks: int,
    first: int,
) -> Trials:
    """Draw trials whose known values are those of a rover profile."""
    noises = {
        "noise_m": ranges.noise_m if known.noise_m is None else known.noise_m,
        "noise_rad": ranges.noise_rad if known.noise_rad is None else known.noise_rad,
    }
    others = ranges.model_copy(update={"rover": None, **noises})
    drawn = draw_trials(others, model, seed, count=count, ticks=ticks, first=first)
    odometry = _columns(drawn.odometry, known.odometry_distance, known.odometry_heading)
    wheel_mismatch = _columns(drawn.wheel_mismatch[:, None], known.wheel_mismatch_rad_m)[:, 0]
    slip = _columns(drawn.slip[:, None], known.slip_s)[:, 0]
    drift = _columns(drawn.drift[:, None], known.drift_rad_s)[:, 0]
    drawn_delay_s: FloatArray = drawn.delay.astype(np.float64) * SUBSTEP_S
    delay_s = _columns(drawn_delay_s, known.delay_v_s, known.delay_omega_s)
    turn_gain = drawn.turning[:, 0]
    if known.odometry_heading is not None:
        odometry[:, 1] *= turn_gain  # known is the share of the true turn, not of the wheels'
    if known.wheel_mismatch_rad_m is not None:
        wheel_mismatch /= turn_gain
    if known.slip_s is not None:
        slip *= turn_gain
    shares = _share(known.accel, model.accel), _share(known.alpha, model.alpha)
    own = _share(known.decel, model.decel), _share(known.alpha_decel, model.alpha_decel)
    braking = (usual if share is None else share for share, usual in zip(own, shares, strict=True))
    acceleration = _columns(drawn.acceleration, *shares, *braking)
    for column, value in ((1, known.alpha), (3, known.alpha_decel or known.alpha)):
        if value is not None:
            acceleration[:, column] /= turn_gain
    errs = (odometry - 1.0).any() or wheel_mismatch.any() or slip.any() or drift.any()
    return drawn._replace(
        exact=drawn.exact and not errs,
        acceleration=acceleration,
        delay=np.rint(delay_s / SUBSTEP_S).astype(np.int64),
        # A profile's gains are measured by odometry.
        gain=_columns(drawn.gain * odometry, known.gain_v, known.gain_omega) / odometry,
        odometry=odometry,
        wheel_mismatch=wheel_mismatch,
        slip=slip,
        drift=drift,
        turning=_columns(drawn.turning, None, known.rotation_center_m),
        motors=_columns(drawn.motors, known.dead_band_v, known.dead_band_omega),
    )


def _share(value: float | None, whole: float) -> float | None:
    return None if value is None else value / whole


def _columns(drawn: FloatArray, *known: float | None) -> FloatArray:
    """Return what was drawn (N, columns), but for the columns that are known."""
    filled = drawn.copy()
    for column, value in enumerate(known):
        if value is not None:
            filled[:, column] = value
    return filled


def _lost(ranges: Randomization, chance: FloatArray) -> NDArray[np.bool_]:
    """Return (N, T) what a two-state channel loses: bursts of a mean length, a share lost in all."""
    ends = 1.0 / ranges.burst
    begins = ends * ranges.lost / (1.0 - ranges.lost)
    lost = np.zeros(chance.shape, np.bool_)
    before = np.zeros(len(chance), np.bool_)
    for tick in range(chance.shape[1]):
        before = np.where(before, chance[:, tick] >= ends, chance[:, tick] < begins)
        lost[:, tick] = before
    return lost


def trial_model(model: RoverModel, trials: Trials, row: int) -> RoverModel:
    """Return the rover of one trial."""
    accel, alpha, decel, alpha_decel = trials.acceleration[row].tolist()
    return trial_body(model, trials, row).model_copy(
        update={
            "accel": model.accel * accel,
            "decel": model.decel * decel,
            "alpha": model.alpha * alpha,
            "alpha_decel": model.alpha_decel * alpha_decel,
        }
    )


def trial_body(model: RoverModel, trials: Trials, row: int) -> RoverModel:
    """Return the rover of one trial with the accelerations of the model."""
    delay_v, delay_omega = trials.delay[row].tolist()
    turn_gain, rotation_center_m = trials.turning[row].tolist()
    return model.model_copy(
        update={
            "delay_v_s": delay_v * SUBSTEP_S,
            "delay_omega_s": delay_omega * SUBSTEP_S,
            "turn_gain": turn_gain,
            "rotation_center_m": rotation_center_m,
        }
    )
