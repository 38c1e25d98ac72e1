"""A known centre of rotation: may the reference anticipate that the rover slides as it turns?

    python -m sim.studies.known_center DRIVER TRIALS SEED

prints one JSON object a line, for a policy or a law on robots of ``skid`` with one centre of rotation. The
driver tracks the rover's middle, as it does without this knowledge, or the centre. The centre does not slide:
it moves as the middle of a rover without skid does. So its drive is that of such a rover on the course of the
centre. The pose of the centre is then judged, which is within 6 mm of the middle's error at 0.1 rad.
"""

import json
import sys

import numpy as np

from rover_ncp.core.geometry import Pose, compose, inverse
from rover_ncp.course.course import Course, load_course
from sim.evaluate.driver import load_driver
from sim.learn.evaluator import Outcomes
from sim.world.described import default_rover
from sim.world.randomization import Trials, draw_trials, load_randomization

CENTERS_M = (-0.06, -0.03, 0.03, 0.06)


def of_centre(middle: Pose, center_m: float) -> Pose:
    """Return the pose of the centre of rotation, in the frame in which the centre starts at the origin."""
    offset = Pose(center_m, 0.0, 0.0)
    return compose(compose(offset, middle), inverse(offset))


def course_of_centre(course: Course, center_m: float) -> Course:
    """Return the course that the centre of rotation drives while the middle drives ``course``."""
    points = [
        point.model_copy(update=of_centre(point.pose, center_m)._asdict()) for point in course.checkpoints
    ]
    return course.model_copy(update={"checkpoints": tuple(points)})


def main() -> None:
    """Compare from the command line."""
    name, count, seed = sys.argv[1:]
    driver, model, course = load_driver(name), default_rover(), load_course("parking")
    ranges = load_randomization("skid")
    drawn = draw_trials(ranges, model, int(seed), count=int(count), ticks=course.ticks)

    def outcomes(course: Course, trials: Trials) -> Outcomes:
        return driver.evaluator([course], model, trials).outcomes(driver.vector)

    straight = drawn._replace(turning=drawn.turning * (1.0, 0.0))
    for center_m in CENTERS_M:
        sliding = drawn._replace(turning=straight.turning + np.array((0.0, center_m)))
        starts = np.array([of_centre(Pose(*start), center_m) for start in drawn.start.tolist()])
        found = {
            "middle": outcomes(course, sliding),
            "centre": outcomes(course_of_centre(course, center_m), straight._replace(start=starts)),
        }
        for tracked, each in found.items():
            fields = {
                "center_m": center_m,
                "tracked": tracked,
                "parked": float(each.parked.mean()),
                "error_m_p95": round(float(np.percentile(each.error_m, 95)), 4),
                "error_rad_p95": round(float(np.percentile(each.error_rad, 95)), 4),
            }
            print(json.dumps(fields), flush=True)


if __name__ == "__main__":
    main()
