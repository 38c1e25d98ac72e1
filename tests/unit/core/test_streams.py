"""Random streams: no two of a seed share bits, and everything draws from one of them."""

import numpy as np
import pytest

from rover_ncp.core.streams import Domain, stream_seed
from sim.world.described import default_rover
from sim.world.random_course import random_course
from sim.world.randomization import draw_trials, load_randomization
from sim.world.skid_robot import SkidRanges, draw_robot

INDICES = (*range(20), 2**32 - 1, 2**32, 2**33 + 5, 2**40)


@pytest.mark.parametrize("seed", [0, 1, 2**63 - 1])
def test_no_two_streams_of_a_seed_share_bits(seed):
    words = [np.random.SeedSequence(seed).generate_state(8)]
    words += [stream_seed(seed, domain, index).generate_state(8) for domain in Domain for index in INDICES]
    assert len({tuple(row.tolist()) for row in words}) == 1 + len(Domain) * len(INDICES)
    assert len(np.unique(np.concatenate(words))) > 8 * len(words) - 5  # by chance, 32 bits may be equal


def test_course_robot_skid_and_ground_of_a_trial_are_independent():
    """The start offset and the length of a course once came from the same bits (correlation 0.9995)."""
    count = 200
    trials = draw_trials(load_randomization("full"), default_rover(), 1, count=count, ticks=320)
    courses = [random_course(1, number) for number in range(count)]
    of_course = [[course.start_signal_s, course.checkpoints[-2].t, *course.goal] for course, _ in courses]
    drawn = [trials.start, trials.delay, trials.gain, trials.odometry, trials.acceleration[:, :2]]
    assert _largest_correlation(np.column_stack(drawn), np.array(of_course)) < 0.3
    trials = draw_trials(load_randomization("skid"), default_rover(), 1, count=count, ticks=1)
    ranges = SkidRanges(mass=0.2, friction=(0.4, 1.0))
    robots = [draw_robot(ranges, 1, number) for number in range(count)]
    of_robot = np.array([[robot.mass_kg, robot.friction] for robot in robots])
    assert _largest_correlation(trials.turning, of_robot) < 0.3


def _largest_correlation(left, right):
    together = np.corrcoef(np.column_stack([left, right]), rowvar=False)
    return np.abs(together[: left.shape[1], left.shape[1] :]).max()
