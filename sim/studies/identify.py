"""How well a robot can be identified: mock robots with random errors, on a virtual clock or live.

    python -m sim.studies.identify full 77 10
    python -m sim.studies.identify full 77 10 outside

identifies robots 0 to 9 of seed 77, drawn from the ranges ``full``, and prints how far each number is from
the truth; with ``outside``, with noisy external poses beside odometry.
"""

import json
import sys
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np

from bridge.robots import ROBOTS
from deploy.excitation import FENCE_M, excite
from deploy.guard import Guard
from deploy.identification import identify
from deploy.intake import Intake
from deploy.link import Link
from deploy.motion_log import motion_log
from deploy.waits import Waits
from rover_ncp.core.geometry import Pose
from rover_ncp.core.messages import COURSE_FRAME, pose_with_covariance
from rover_ncp.core.profile import RoverProfile
from rover_ncp.core.recording import Recorded
from sim.pioneer.firmware import Firmware
from sim.pioneer.models import rover_model_of
from sim.pioneer.trial import BaseTrial, rover_of
from sim.studies.stack import MODEL
from sim.studies.virtual import Air, World
from sim.world.bay import Bay
from sim.world.randomization import Randomization, Trials, draw_trials, load_randomization
from sim.world.rover import SUBSTEP_S

__all__ = ["Errors", "errors", "identified", "robot"]

TICKS = 600
"""How long a robot's trial lasts: longer than the drive that identifies it."""
OUTSIDE_M, OUTSIDE_RAD = 0.005, 0.0087
"""Noise of the external poses."""


class Errors(NamedTuple):
    """Found minus true: delays in s, all else as shares of the truth."""

    delay_v_s: float
    delay_omega_s: float
    gain_v: float
    """Against what odometry sees; so is the next."""
    gain_omega: float
    true_gain_v: float
    """Against the true speed over the command; so is the next. Better with external poses."""
    true_gain_omega: float
    accel: float
    alpha: float


def robot(ranges: Randomization, seed: int, number: int) -> Trials:
    """Draw a robot, as row 0."""
    model = rover_model_of(ROBOTS[MODEL])
    return draw_trials(ranges, model, seed, count=1, ticks=TICKS, first=number)


def identified(trials: Trials, *, outside: bool = False, seed: int = 0) -> RoverProfile:
    """Identify a robot through firmware, bridge and driver's code on a virtual clock."""
    rover = rover_of(trials, rover_model_of(ROBOTS[MODEL]), Bay(()))
    world = World(Firmware(MODEL, rover, trial=BaseTrial(trials)))
    heard: list[Recorded] = []
    look = _camera(rover, world, heard, np.random.default_rng(seed)) if outside else lambda: None

    def record(message: Recorded) -> None:
        heard.append(message)
        if message.topic == "odom":
            look()

    air = Air(world, rover.pose, record)
    link = cast(Link, air)
    intake = Intake(link.odometry)
    guard = Guard(link, intake, Waits(), lambda: False, world)
    guard.wait(True, "")
    excite(link, intake, guard, FENCE_M, world)
    return identify(motion_log(heard), "mock")


def _camera(
    rover: Any, world: World, heard: list[Recorded], noise: np.random.Generator
) -> Callable[[], None]:
    """Return a camera above the bay, that tells where the rover is when it is called."""
    spread = np.diag(np.square([OUTSIDE_M, OUTSIDE_M, OUTSIDE_RAD]))

    def look() -> None:
        seen = np.array(rover.pose) + noise.normal(size=3) * [OUTSIDE_M, OUTSIDE_M, OUTSIDE_RAD]
        now = world.time_ns()
        data = pose_with_covariance(Pose(*seen.tolist()), spread, now, COURSE_FRAME)
        heard.append(Recorded("pose", "geometry_msgs/msg/PoseWithCovarianceStamped", data, now, now))

    return look


def errors(found: RoverProfile, trials: Trials) -> Errors:
    """Compare a profile with the robot it is of."""
    gain, odometry = trials.gain[0], trials.odometry[0]
    delay, effort = trials.delay[0] * SUBSTEP_S, trials.acceleration[0]
    model = rover_model_of(ROBOTS[MODEL])
    seen = _or_nan(found.gain_v), _or_nan(found.gain_omega)
    true = seen[0] / (found.odometry_distance or 1.0), seen[1] / (found.odometry_heading or 1.0)
    return Errors(
        _or_nan(found.delay_v_s) - delay[0],
        _or_nan(found.delay_omega_s) - delay[1],
        seen[0] / (gain[0] * odometry[0]) - 1.0,
        seen[1] / (gain[1] * odometry[1]) - 1.0,
        true[0] / gain[0] - 1.0,
        true[1] / gain[1] - 1.0,
        _or_nan(found.accel) / (model.accel * effort[0]) - 1.0,
        _or_nan(found.alpha) / (model.alpha * effort[1]) - 1.0,
    )


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def main(name: str, seed: str, count: str, outside: str = "") -> None:
    """Print each robot's errors, then the largest of each kind."""
    ranges = load_randomization(name)
    found = []
    for number in range(int(count)):
        trials = robot(ranges, int(seed), number)
        profile = identified(trials, outside=bool(outside), seed=number)
        found.append(errors(profile, trials))
        print(json.dumps({key: round(float(value), 5) for key, value in found[-1]._asdict().items()}))
    worst = np.abs(np.array(found)).max(axis=0).tolist()
    print(
        json.dumps(
            {"largest": {key: round(value, 5) for key, value in zip(Errors._fields, worst, strict=True)}}
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
