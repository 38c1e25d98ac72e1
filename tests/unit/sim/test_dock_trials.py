"""Trials of docking in the stack simulation: their starts, the camera's noise model, and how they count."""

import dataclasses
import math

import numpy as np
import pytest
from kit.virtual_docking import place

from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.geometry import distance
from rover_ncp.wire.messages import read_pose
from sim.evaluate.evaluate import tally
from sim.evaluate.results import docking_result, drives_of
from sim.stack.docking import BEARING_RAD, DISTANCES_M, DockTrials
from sim.stack.tag_camera import TagLocaliser
from sim.stack.trials import drive_all
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover
from sim.world.randomization import load_randomization


class LosesNone(TagLocaliser):
    lost = 0.0


def trials(**changed):
    policy = load_policy("course")
    return DockTrials(policy, load_policy("dock"), place(**changed), load_randomization("none"), 3)


def measured(pose, direction="forward", kind=TagLocaliser, seconds=400.0):
    """Return the poses that a rover's camera sends from where it stands."""
    where, found = place(direction=direction), []
    rover = PymunkRover(default_rover(), Ground(()), pose)
    stream = np.random.default_rng(4)
    localiser = kind(rover, where, stream, lambda data, now_ns: found.append(read_pose(data)))
    for now in np.arange(0.0, seconds, 0.125).tolist():
        localiser.observe(now)
    return found


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_starts_lie_before_the_place_and_see_the_tags(direction):
    drawn = trials(direction=direction)
    for number in range(60):
        start = drawn.start(number)
        assert DISTANCES_M[0] <= distance(start, drawn.place.goal) <= DISTANCES_M[1]
        off = drawn.place.errors(start)
        out_m = off.longitudinal_m if direction == "backward" else -off.longitudinal_m
        assert math.atan2(abs(off.lateral_m), out_m) <= BEARING_RAD + 1e-9
        assert measured(start, direction, LosesNone, seconds=1.0)


def test_a_trial_whose_robot_never_sees_the_tags_is_counted():
    class Blind(TagLocaliser):
        farthest_m = 0.1

    drawn = dataclasses.replace(trials(), localiser=Blind)
    driven = drive_all(drawn.drive, 1, 1)
    assert docking_result("dock", driven).verdicts == {"stopped": 1}
    assert tally(driven).failures == {"stopped by start-pose": 1}


def test_docked_counts_by_the_true_pose():
    """The tags may hang beside where the place has them: then its poses are wrong."""

    class Moved(TagLocaliser):
        def measure(self, wall_ns):
            seen = super().measure(wall_ns)
            return seen and seen._replace(pose=seen.pose._replace(y=seen.pose.y + 0.03))

    drawn = dataclasses.replace(trials(retries=0), localiser=Moved)
    driven = drive_all(drawn.drive, 1, 1)
    found, docking = tally(driven), docking_result("dock", driven)
    assert (docking.verdicts, docking.falsely_docked) == ({"docked": 1}, 1)
    assert (found.success_rate, found.failures) == (0.0, {"falsely docked": 1})
    assert [drive.parked for drive in drives_of(driven)] == [False]
