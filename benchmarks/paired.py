"""Two drivers on the same trials: does one park where the other does not more often than by chance?

    python -m benchmarks.paired FIRST SECOND --randomize harsh --trials 1000 --seed 1 [--unseen COURSES]

prints one JSON object. Drivers are those of ``rover-ncp eval``. --unseen drives on so many courses outside
the training set instead of the paper's. With --body or --sensors, as ``eval`` has them, the trials are driven
through the stack, else in plain simulation.
"""

import argparse
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from rover_ncp.course.course import Course, load_course
from sim.evaluate.evaluate import drive_trials, unseen_courses
from sim.learn.engine.driver import load_driver
from sim.stack.camera import Camera
from sim.stack.trials import Stack, drive_all
from sim.world.bodies import Body
from sim.world.randomization import Randomization, load_randomization


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


def parked(
    driver: str, courses: Sequence[Course], ranges: Randomization, *, trials: int, seed: int
) -> NDArray[np.bool_]:
    """Return in which trials of a seed (trials,) a law, or a policy by name or file, parked."""
    found = drive_trials(load_driver(driver), courses, ranges, trials=trials, seed=seed)
    return np.array([not trial.reason for trial in found])


def parked_in_stack(stack: Stack, trials: int) -> NDArray[np.bool_]:
    """Return in which trials (trials,) a stack's driver parked."""
    return np.array([trial.parked for trial in drive_all(stack, trials, None)])


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
    options.add_argument("--randomize", required=True)
    options.add_argument("--trials", type=int, required=True)
    options.add_argument("--seed", type=int, required=True)
    options.add_argument("--unseen", type=int, help="number of courses")
    options.add_argument("--body", type=Body, choices=list(Body))
    options.add_argument("--sensors", choices=["encoders", "gyro", "camera", "both"])
    given = options.parse_args()
    courses = unseen_courses(given.seed, given.unseen) if given.unseen else [load_course("parking")]
    ranges = load_randomization(given.randomize, given.body or Body.PYMUNK)

    def run(name: str) -> NDArray[np.bool_]:
        if not (given.body or given.sensors):
            return parked(name, courses, ranges, trials=given.trials, seed=given.seed)
        stack = Stack(
            load_driver(name),
            tuple(courses),
            ranges,
            given.seed,
            gyro=given.sensors in {"gyro", "both"},
            camera=Camera() if given.sensors in {"camera", "both"} else None,
        )
        return parked_in_stack(stack, given.trials)

    runs = [run(name) for name in given.drivers]
    counts = paired(*runs)
    fields: dict[str, Any] = counts._asdict() | {"p": counts.p, "drivers": given.drivers}
    print(json.dumps(fields))


if __name__ == "__main__":
    main()
