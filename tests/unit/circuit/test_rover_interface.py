"""The connection of a policy to a rover: the same numbers everywhere, and errors that say what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from kit.paths import DATA

from deploy.drive.controller import Controller
from deploy.estimator.settings import EstimatorSettings
from deploy.view.trace import motor_outputs
from rover_ncp import api
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.geometry import Pose
from sim import api as sim_api
from sim.learn.engine.evaluator import Evaluator

SHORT = str(DATA / "short_course.yaml")


def with_names(policy, inputs, outputs):
    """Return a policy whose inputs and outputs have other names."""

    def renamed(channels, names):
        return tuple(
            channel.model_copy(update={"name": name}) for channel, name in zip(channels, names, strict=True)
        )

    sensing, motors = policy.sensing, policy.motors
    return replace(
        policy,
        sensing=sensing.model_copy(update={"inputs": inputs, "channels": renamed(sensing.channels, inputs)}),
        motors=motors.model_copy(update={"outputs": outputs, "channels": renamed(motors.channels, outputs)}),
    )


@pytest.mark.long
@pytest.mark.parametrize("name", ["parking", "course"])
def test_simulator_lanes_and_controller_agree_to_the_last_bit(name):
    policy, course = api.load_policy(name), api.load_course(SHORT)
    run = sim_api.rollout(policy, course)
    assert np.ptp(run.commands, axis=0).all()
    [[total]] = Evaluator(policy, course).outcomes(policy.parameters()).total
    assert total == run.total
    controller = Controller(policy, course, EstimatorSettings())
    controller.start(Pose(0.0, 0.0, 0.0), 0.0)
    assert controller.tick(0, 0.0).command == tuple(run.commands[0])
    assert motor_outputs(policy, run.potentials) == pytest.approx(run.commands, abs=1e-12)


def test_an_unknown_name_is_answered_with_the_known_ones():
    parking, course = api.load_policy("parking"), api.load_course(SHORT)
    with pytest.raises(ConfigError, match=r"unknown signals: smell \(expected some of x, .*turn"):
        api.CourseDriver(with_names(parking, ("x", "y", "smell", "start"), ("v", "omega")), course)
    with pytest.raises(ConfigError, match=r"outputs are left, right; expected v, omega"):
        api.CourseDriver(with_names(parking, ("x", "y", "theta", "start"), ("left", "right")), course)
