"""Worth of the estimator's settings: the same trials through the stack with changed settings.

    python -m benchmarks.ablation course --body mujoco --randomize slope --sensors gyro --trials 60 --seed 1

prints a line for the shipped settings and one for each standard deviation and each random walk of an error
state at 1e-9. ``--set NAME=VALUE,NAME=VALUE`` drives these changes instead; repeat it for more. The other
options are those of ``rover-ncp eval --stack``.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from deploy.estimator.settings import EstimatorSettings
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import Parked
from rover_ncp.robot.description import load_description
from sim.evaluate.evaluate import trial_count
from sim.evaluate.options import Sensors
from sim.learn.policies import any_policy
from sim.stack.estimates import summary
from sim.stack.trials import Stack, drive_all
from sim.world.bodies import Body
from sim.world.described import ranges_for

NONE = 1e-9
"""Value of a standard deviation that turns its state off."""


def ablations() -> list[dict[str, float]]:
    """Return the shipped settings, and those without each error state or its walk."""
    names = [name for name in EstimatorSettings.model_fields if "_std" in name or "_walk" in name]
    return [{}, *({name: NONE} for name in names)]


def changes_of(text: str) -> dict[str, float]:
    """Return changed settings of NAME=VALUE,NAME=VALUE. Raises ArgumentTypeError."""
    changes = dict[str, float]()
    for change in text.split(","):
        name, _, value = change.partition("=")
        if name not in EstimatorSettings.model_fields:
            raise argparse.ArgumentTypeError(f"the estimator has no setting {name}")
        changes[name] = float(value)
    return changes


def changes_words(changes: Mapping[str, float]) -> str:
    """Return changed settings as `changes_of` takes them; "shipped" for none."""
    return ",".join(f"{name}={value:g}" for name, value in changes.items()) or "shipped"


def row(stack: Stack, changes: Mapping[str, float], trials: int) -> str:
    """Drive the trials with changed settings; return their line."""
    driven = drive_all(replace(stack, estimator=changes).drive, trials, None)
    parked = [trial.parked for trial in driven]
    found = summary([trial.belief for trial in driven], parked)
    plain = np.array([trial.belief.verdict is Parked.YES for trial in driven])
    p50, p95 = (found.error_m.p50, found.error_m.p95) if found.error_m else (np.nan, np.nan)
    return (
        f"{np.mean(parked):7.1%} {np.count_nonzero(plain & ~np.array(parked)):6d} {np.mean(plain):7.1%} "
        f"{found.inside['95%'] or np.nan:7.1%} {1000 * p50:5.0f} {1000 * p95:5.0f}  " + changes_words(changes)
    )


def main() -> None:
    """Compare from the command line."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("driver")
    options.add_argument("--course", default="parking")
    options.add_argument("--randomize")
    options.add_argument("--trials", type=int, required=True)
    options.add_argument("--seed", type=int, required=True)
    options.add_argument("--body", type=Body, choices=list(Body), default=Body.PYMUNK)
    options.add_argument("--sensors", type=Sensors, choices=list(Sensors), default=Sensors.ENCODERS)
    options.add_argument("--model")
    options.add_argument("--identify", action="store_true")
    options.add_argument("--set", action="append", default=[], type=changes_of)
    given = options.parse_args()
    robot = load_description(given.model) if given.model else None
    ranges = ranges_for(given.randomize, None, given.body, robot)
    gyro = given.sensors in {Sensors.GYRO, Sensors.BOTH}
    camera = given.sensors in {Sensors.CAMERA, Sensors.BOTH}
    course = (load_course(given.course),)
    stack = Stack(any_policy(given.driver), course, ranges, given.seed, gyro, camera, given.identify, robot)
    trials = trial_count(given.trials, 1, ranges, stack.varies)
    print(" parked  quiet   plain  inside   p50   p95  mm; changed setting")
    for changes in given.set or ablations():
        print(row(stack, changes, trials), flush=True)


if __name__ == "__main__":
    main()
