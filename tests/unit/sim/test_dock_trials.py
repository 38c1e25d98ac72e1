"""Trials of docking in the stack simulation: their starts, the camera's noise model, and how they count."""

import dataclasses

from kit.virtual_docking import place

from rover_ncp.circuit.policy_file import load_policy
from sim.evaluate.evaluate import tally
from sim.evaluate.results import docking_result, drives_of
from sim.stack.docking import DockTrials
from sim.stack.tag_camera import TagLocaliser
from sim.stack.trials import drive_all
from sim.world.randomization import load_randomization


def trials(**changed):
    policy = load_policy("course")
    return DockTrials(policy, load_policy("dock"), place(**changed), load_randomization("none"), 3)


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
