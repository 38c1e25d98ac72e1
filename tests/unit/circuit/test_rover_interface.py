"""The connection of a policy to a rover: the same numbers everywhere, and errors that say what is wrong."""

import re

import numpy as np
import pytest
from kit.paths import DATA

from deploy.drive.controller import Controller
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.circuit.policy_file import load_policy, policy_from_yaml, policy_to_yaml
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import load_course
from rover_ncp.neurons.trace import motor_outputs
from sim.learn.rollout import rollout

SHORT = str(DATA / "short_course.yaml")


@pytest.mark.long
@pytest.mark.parametrize("name", ["parking", "course"])
def test_simulator_controller_and_trace_agree(name):
    policy, course = load_policy(name), load_course(SHORT)
    run = rollout(policy, course)
    assert np.ptp(run.commands, axis=0).all()
    controller = Controller(policy, course, EstimatorSettings())
    controller.start(Pose(0.0, 0.0, 0.0), 0.0)
    assert controller.tick(0, 0.0).command == tuple(run.commands[0])
    assert motor_outputs(policy, run.potentials) == pytest.approx(run.commands, abs=1e-12)


def test_unknown_outputs_are_answered_with_the_known_ones():
    named = policy_to_yaml(load_policy("parking")).replace("name: omega", "name: left")
    policy = policy_from_yaml(re.sub(r"(outputs.*)\bomega\b", r"\1left", named), "renamed")
    with pytest.raises(ConfigError, match="outputs are v, left; expected v, omega"):
        RoverInterface(policy)
