"""The shipped policies do what their pages state, on trials that were not used in training."""

import math

import numpy as np
import pytest

from rover_ncp.circuit.motors import four_dof_motors
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.files import shipped_names
from rover_ncp.course.course import load_course
from sim.evaluate.evaluate import drive_trials, tally, unseen_courses
from sim.learn.policies import any_policy
from sim.learn.rollout import rollout
from sim.world.randomization import load_randomization


@pytest.mark.parametrize("ranges", ["full", "harsh", "skid"])
def test_course_parks_the_same_unmeasured_robots_as_before(ranges):
    policy, courses = any_policy("course"), [load_course("parking")]
    found = tally(drive_trials(policy, courses, load_randomization(ranges), trials=50, seed=2024))
    assert found.success_rate == 1.0, found.failures


def test_it_drives_courses_it_never_saw():
    courses, full = unseen_courses(2024, 6), load_randomization("full")
    found = tally(drive_trials(any_policy("course"), courses, full, trials=24, seed=2024))
    assert found.success_rate == 1.0, found.failures


def test_dock_reaches_two_centimetres_and_two_degrees_on_nominal_robots():
    starts = load_randomization("none").model_copy(update={"start_m": 0.1, "start_rad": math.radians(10.0)})
    course = load_course("approach")
    assert course.parked.position_m <= 0.02
    assert course.parked.heading_rad <= math.radians(2.01)
    found = tally(drive_trials(any_policy("dock"), [course], starts, trials=50, seed=2024))
    assert found.success_rate >= 0.96, found.failures


def test_reverse_backs_into_the_bay_by_its_pose_alone_and_touches_nothing():
    policy = load_policy("reverse")
    assert (policy.motors, policy.courses) == (four_dof_motors(), ("reverse",))
    run = rollout(policy, load_course("reverse"))
    assert run.verdict.parked, run.verdict.reason
    assert run.verdict.error_m < 0.05
    assert run.commands[:, 0].min() < -0.1
    assert run.commands[:, 0].max() < 0.05
    assert np.ptp(run.poses[:, 2]) > 0.9


@pytest.mark.parametrize("name", shipped_names("policies"))
def test_a_shipped_policy_has_its_name_and_the_command_that_reproduces_it(name):
    policy = load_policy(name)
    assert policy.circuit.name == name
    assert policy.provenance["command"].startswith("rover-ncp train")
    assert policy.provenance["made_with"]["commit"]
