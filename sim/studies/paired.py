"""Two drivers on the same trials: does one park where the other does not more often than by chance?

    python -m sim.studies.paired POLICY LAW RANGES TRIALS SEED [UNSEEN]

prints one JSON object; with UNSEEN, on so many courses outside the training set instead of the paper's.
"""

import json
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import Course, load_course
from sim.evaluate.evaluate import unseen_courses
from sim.evaluate.laws import LAWS, law_evaluator
from sim.learn.evaluator import Evaluator
from sim.world.randomization import Randomization, draw_trials, load_randomization
from sim.world.rover import RoverModel


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
    drawn = draw_trials(
        ranges, RoverModel(), seed, count=trials, ticks=max(course.ticks for course in courses)
    )
    if driver in LAWS:
        found = law_evaluator(driver, courses, drawn).outcomes(LAWS[driver].tuned)
    else:
        policy = load_policy(driver)
        found = Evaluator(policy, courses, trials=drawn).outcomes(policy.parameters())
    hits: NDArray[np.bool_] = found.parked[0]
    return hits


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
    first, second, ranges, trials, seed, *unseen = sys.argv[1:]
    courses = unseen_courses(int(seed), int(unseen[0])) if unseen else [load_course("parking")]
    runs = [
        parked(driver, courses, load_randomization(ranges), trials=int(trials), seed=int(seed))
        for driver in (first, second)
    ]
    counts = paired(*runs)
    fields: dict[str, Any] = counts._asdict() | {"p": counts.p, "drivers": [first, second]}
    print(json.dumps(fields))


if __name__ == "__main__":
    main()
