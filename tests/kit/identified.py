"""Random robots, driven as `rover-ncp identify` does on a virtual clock, and the truth about them."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bridge.pioneer.setpoints import MotionLimits
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.identify.excitation import FENCE_M, DeadBands, excite
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.core.streams import Domain, random_stream
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.lasting_error import LastingError
from rover_ncp.robot.profile import OF_THE_GROUND, RoverProfile
from rover_ncp.wire.messages import COURSE_FRAME, pose_with_covariance
from sim.base.firmware import Firmware
from sim.base.trial import BaseTrial, rover_of
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground
from sim.world.randomization import Randomization, Trials, draw_trials
from sim.world.rover import SUBSTEP_S

TICKS = 600
"""How long a robot's trial lasts: longer than the drive that identifies it."""
OUTSIDE = [0.005, 0.005, 0.0087]
"""Noise of the external poses, which come from above the ground with each odometry."""


class Error(NamedTuple):
    """Found minus true value, and the standard deviation in the profile; in the value's unit."""

    error: float
    std: float


def robot(ranges: Randomization, seed: int, number: int, **different: float) -> Trials:
    """Draw a robot, as row 0, of the default model with ``different`` values."""
    return draw_trials(ranges, default_rover(**different), seed, count=1, ticks=TICKS, first=number)


class Driven(NamedTuple):
    """A drive that is over: its messages, the way from its start, what stopped it, and the base."""

    messages: list[Recorded]
    farthest_m: float
    stopped: SafetyStop | None
    base: Firmware
    bands: DeadBands
    lasting: Callable[[str], LastingError]


def driven(trials: Trials, *, outside: bool = False, fence_m: float = FENCE_M, seed: int = 0) -> Driven:
    """Drive a robot as `identify` does, through firmware, bridge and driver's code on a virtual clock."""
    rover = rover_of(trials, default_rover(), Ground(()))
    base, start, farthest_m = Firmware(DEFAULT_ROBOT, rover, trial=BaseTrial(trials)), rover.pose, 0.0

    def observe(_now: float) -> None:
        nonlocal farthest_m
        farthest_m = max(farthest_m, distance(rover.pose, start))

    base.observe = observe
    bridge, noise = VirtualBridge(base), random_stream(seed, Domain.STUDY)
    received: list[Recorded] = []

    def record(message: Recorded) -> None:
        received.append(message)
        if outside and message.topic == "odom":
            now, seen = bridge.time_ns(), np.array(rover.pose) + noise.normal(size=3) * OUTSIDE
            data = pose_with_covariance(Pose(*seen.tolist()), np.diag(np.square(OUTSIDE)), now, COURSE_FRAME)
            received.append(Recorded("pose", "geometry_msgs/msg/PoseWithCovarianceStamped", data, now, now))

    link = VirtualLink(bridge, start, record)
    measurements = Measurements(link)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
    monitor.wait()
    stopped, bands = None, (None, None)
    try:
        bands = excite(link, measurements, monitor, fence_m, bridge)
    except SafetyStop as stop:
        stopped = stop
    messages = [*received]
    bridge.sleep(2.0)
    return Driven(messages, farthest_m, stopped, base, bands, link.lasting_error)


def truth(ranges: Randomization, trials: Trials) -> dict[str, float]:
    """Return the true values of the robot in row 0, by their names in a profile."""
    odometry, limits = trials.odometry[0], MotionLimits()
    delay_v, delay_omega = (trials.delay[0] * SUBSTEP_S).tolist()
    gain_v, gain_omega = (trials.gain[0] * odometry).tolist()
    accel, alpha, decel, alpha_decel = trials.acceleration[0].tolist()
    turn_gain, rotation_center_m = trials.turning[0].tolist()
    return {
        "delay_v_s": delay_v,
        "delay_omega_s": delay_omega,
        # As the bridge sets them in the base, in whole mm/s² and deg/s².
        "accel": round(limits.accel * 1000) / 1000 * accel,
        "decel": round(limits.decel * 1000) / 1000 * decel,
        "alpha": math.radians(round(math.degrees(limits.alpha))) * alpha * turn_gain,
        "alpha_decel": math.radians(round(math.degrees(limits.alpha_decel))) * alpha_decel * turn_gain,
        "gain_v": gain_v,
        "gain_omega": gain_omega,
        "noise_m": ranges.noise_m,
        "noise_rad": ranges.noise_rad,
        "odometry_distance": float(odometry[0]),
        "odometry_heading": float(odometry[1]) / turn_gain,
        "rotation_center_m": rotation_center_m,
        "rotation_center_left_m": 0.0,
        "wheel_mismatch_rad_m": float(trials.wheel_mismatch[0]) * turn_gain,
        "slip_s": float(trials.slip[0]) / turn_gain,
        **dict.fromkeys(OF_THE_GROUND, 0.0),  # level
    }


def errors(found: RoverProfile, true: dict[str, float]) -> dict[str, Error]:
    """Compare the values of a profile that have a standard deviation with the truth."""
    return {key: Error(getattr(found, key) - true[key], std) for key, std in found.std.items()}
