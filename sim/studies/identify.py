"""How well robots are identified: whether the truth is within 1.96 standard deviations of each value.

    python -m sim.studies.identify --robots 500 --seed 1 --randomize full

draws robots and drives each as `rover-ncp identify` does, through firmware, bridge and driver's code on a
virtual clock, with noisy external poses beside odometry. It prints a row for each value: the share of robots
whose 95 % interval holds the truth, their number, the median standard deviation, and the root mean square of
error over standard deviation. Values that were found to be zero have no interval and are not counted.
"""

import argparse
import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rich.progress import track

from bridge.pioneer.setpoints import MotionLimits
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.identify.excitation import FENCE_M, excite
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from rover_ncp.core.files import USUAL_ROBOT
from rover_ncp.core.geometry import Pose
from rover_ncp.core.messages import COURSE_FRAME, pose_with_covariance
from rover_ncp.core.recording import Recorded
from rover_ncp.core.robot_profile import OF_THE_GROUND, RoverProfile
from sim.learn.workers import process_pool
from sim.pioneer.firmware import Firmware
from sim.pioneer.trial import BaseTrial, rover_of
from sim.stack.virtual import VirtualBridge, VirtualLink
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground
from sim.world.randomization import Randomization, Trials, draw_trials, load_randomization
from sim.world.rover import SUBSTEP_S

TICKS = 600
"""How long a robot's trial lasts: longer than the drive that identifies it."""
OUTSIDE_M, OUTSIDE_RAD = 0.005, 0.0087
"""Noise of the external poses."""
INTERVAL = 1.96
"""Standard deviations on both sides that hold 95 % of a Gaussian."""


class Error(NamedTuple):
    """Found minus true value, and the standard deviation in the profile; in the value's unit."""

    error: float
    std: float


def robot(ranges: Randomization, seed: int, number: int) -> Trials:
    """Draw a robot, as row 0."""
    return draw_trials(ranges, default_rover(), seed, count=1, ticks=TICKS, first=number)


def driven(trials: Trials, *, outside: bool = False, seed: int = 0) -> list[Recorded]:
    """Drive a robot as `identify` does, through firmware, bridge and driver's code on a virtual clock."""
    rover = rover_of(trials, default_rover(), Ground(()))
    bridge = VirtualBridge(Firmware(USUAL_ROBOT, rover, trial=BaseTrial(trials)))
    received: list[Recorded] = []
    look = _camera(rover, bridge, received, np.random.default_rng(seed)) if outside else lambda: None

    def record(message: Recorded) -> None:
        received.append(message)
        if message.topic == "odom":
            look()

    link = VirtualLink(bridge, rover.pose, record)
    measurements = Measurements(link)
    monitor = SafetyMonitor(link, measurements, lambda: False, clock=bridge)
    monitor.wait()
    excite(link, measurements, monitor, FENCE_M, bridge)
    return received


def identified(trials: Trials, *, outside: bool = False, seed: int = 0) -> RoverProfile:
    """Drive and identify a robot."""
    return identify(motion_log(driven(trials, outside=outside, seed=seed)), "mock")


def _camera(
    rover: Any, bridge: VirtualBridge, received: list[Recorded], noise: np.random.Generator
) -> Callable[[], None]:
    """Return a camera above the ground, which publishes where the rover is when it is called."""
    spread = np.diag(np.square([OUTSIDE_M, OUTSIDE_M, OUTSIDE_RAD]))

    def look() -> None:
        seen = np.array(rover.pose) + noise.normal(size=3) * [OUTSIDE_M, OUTSIDE_M, OUTSIDE_RAD]
        now = bridge.time_ns()
        data = pose_with_covariance(Pose(*seen.tolist()), spread, now, COURSE_FRAME)
        received.append(Recorded("pose", "geometry_msgs/msg/PoseWithCovarianceStamped", data, now, now))

    return look


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
        "imbalance_rad_m": float(trials.imbalance[0]) * turn_gain,
        "slip_s": float(trials.slip[0]) / turn_gain,
        **dict.fromkeys(OF_THE_GROUND, 0.0),  # level
    }


def errors(found: RoverProfile, true: dict[str, float]) -> dict[str, Error]:
    """Compare the values of a profile that have a standard deviation with the truth."""
    return {key: Error(getattr(found, key) - true[key], std) for key, std in found.std.items()}


def table(found: Iterable[dict[str, Error]]) -> Iterator[str]:
    """Yield the table: a row for each value, and one for ``all`` together."""
    pooled: dict[str, list[Error]] = {}
    for one in found:
        for key, error in one.items():
            pooled.setdefault(key, []).append(error)
    yield f"{'value':18} {'coverage':>8} {'n':>5} {'median ±':>9} {'rms error/σ':>11}"
    every = [error for errors in pooled.values() for error in errors]
    for key, errors in [*sorted(pooled.items()), ("all", every)]:
        ratios = np.array([error / std for error, std in errors])
        share, rms = np.mean(np.abs(ratios) <= INTERVAL), np.sqrt(np.mean(ratios**2))
        std = "" if key == "all" else f"{np.median([std for _, std in errors]):.5f}"
        yield f"{key:18} {100 * share:6.1f} % {len(errors):5} {std:>9} {rms:11.2f}"


def _study(name: str, seed: int, outside: bool, number: int) -> dict[str, Error]:
    ranges = load_randomization(name)
    trials = robot(ranges, seed, number)
    profile = identified(trials, outside=outside, seed=number)
    return errors(profile, truth(ranges, trials))


def main() -> None:
    """Print the coverage of robots 0 and on of a seed."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--robots", type=int, default=500)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--randomize", default="full", help="the preset that the robots are drawn from")
    options.add_argument("--odometry-only", action="store_true", help="without external poses")
    options.add_argument("--processes", type=int, default=2)
    chosen = options.parse_args()
    study = partial(_study, chosen.randomize, chosen.seed, not chosen.odometry_only)
    with process_pool(chosen.processes, "a process of the study ended unexpectedly") as pool:
        found = list(track(pool.map(study, range(chosen.robots)), "robots", total=chosen.robots))
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
