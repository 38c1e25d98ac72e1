"""The policy reverse backs into the bay between the cars, sensing its pose alone: no reference leads it."""

import numpy as np

from rover_ncp.circuit.motors import four_dof_motors
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.course.course import load_course
from sim.learn.engine.rollout import rollout


def test_it_backs_into_the_bay_and_touches_nothing():
    policy = load_policy("reverse")
    assert policy.motors == four_dof_motors()
    assert policy.courses == ("reverse",)
    run = rollout(policy, load_course("reverse"))
    assert run.verdict.parked, run.verdict.reason
    assert run.verdict.error_m < 0.05
    assert run.commands[:, 0].min() < -0.1
    assert run.commands[:, 0].max() < 0.05
    assert np.ptp(run.poses[:, 2]) > 0.9


def test_policy_contains_the_command_that_reproduces_it():
    provenance = load_policy("reverse").provenance
    assert provenance["command"].startswith("rover-ncp train --course reverse --circuit four_dof")
    assert provenance["made_with"]["commit"]
