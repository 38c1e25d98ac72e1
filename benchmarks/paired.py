"""Two drivers on the same trials: does one park where the other does not more often than by chance?

    python -m benchmarks.paired FIRST SECOND --body mujoco --randomize slope --trials 300 --seed 1

prints one JSON object. The other options are those of ``rover-ncp eval --stack``.
"""

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from rover_ncp.course.course import load_course
from rover_ncp.robot.description import load_description
from sim.evaluate.commands import Sensors, driver_sensors
from sim.evaluate.evaluate import fitted_courses, trial_count
from sim.learn.engine.driver import load_driver
from sim.stack.trials import Stack, drive_all
from sim.world.bodies import Body
from sim.world.described import ranges_for


class Paired(NamedTuple):
    """How many of the same trials parked both, one alone, the other alone, and neither."""

    both: int
    first_only: int
    second_only: int
    neither: int

    @property
    def p(self) -> float:
        """McNemar's exact test, two-sided: the chance of so uneven a split if both were equally good."""
        differing = self.first_only + self.second_only
        return float(binomtest(self.first_only, differing).pvalue) if differing else 1.0


def paired(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Paired:
    """Count the outcomes of the same trials (n,) under two drivers."""
    return Paired(
        both=int(np.count_nonzero(first & second)),
        first_only=int(np.count_nonzero(first & ~second)),
        second_only=int(np.count_nonzero(second & ~first)),
        neither=int(np.count_nonzero(~(first | second))),
    )


def main() -> None:
    """Compare from the command line."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("drivers", nargs=2)
    options.add_argument("--randomize")
    options.add_argument("--trials", type=int, required=True)
    options.add_argument("--seed", type=int, required=True)
    options.add_argument("--body", type=Body, choices=list(Body), default=Body.PYMUNK)
    options.add_argument("--sensors", type=Sensors, choices=list(Sensors))
    options.add_argument("--course", default="parking")
    options.add_argument("--profile", type=Path)
    options.add_argument("--model")
    given = options.parse_args()
    robot = None if given.model is None else load_description(given.model)
    ranges = ranges_for(given.randomize, given.profile, given.body, robot)
    courses, _ = fitted_courses([load_course(given.course)], robot)
    gyro, camera = driver_sensors(given.sensors, robot)

    def run(name: str) -> NDArray[np.bool_]:
        stack = Stack(load_driver(name), tuple(courses), ranges, given.seed, gyro, camera, robot=robot)
        trials = trial_count(given.trials, 1, ranges, stack.varies)
        return np.array([trial.parked for trial in drive_all(stack, trials, None)])

    runs = [run(name) for name in given.drivers]
    counts = paired(*runs)
    fields: dict[str, Any] = counts._asdict() | {"p": counts.p, "drivers": given.drivers}
    print(json.dumps(fields))


if __name__ == "__main__":
    main()
