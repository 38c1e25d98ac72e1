import numpy as np
import pytest
from kit.base_odometry import reported
from kit.virtual_drive import controlled

from deploy.drive.controller import Controller
from deploy.estimator.settings import EstimatorSettings
from rover_ncp.circuit.policy import course_policy
from rover_ncp.circuit.policy_file import load_circuit
from rover_ncp.circuit.runner import Runner
from rover_ncp.core.geometry import ORIGIN, Pose, Velocity, compose, distance
from rover_ncp.course.course import load_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.course.signals import SIGNALS, signals
from sim.learn.rollout import rollout
from sim.world.described import default_rover
from sim.world.randomization import nominal_trials

COURSE = load_course("parking")
DT = 0.1


def test_a_circuit_that_follows_the_course_sees_its_reference_as_in_the_simulator():
    tracker, reference = course_policy(load_circuit("tracking")), plan_reference(COURSE)
    there = Pose(0.06, -0.04, 0.1)
    poses, ticks, _ = controlled(tracker, pose=there, report=reported, latency=0.0)
    runner = Runner(tracker)
    chosen = [SIGNALS.index(name) for name in tracker.sensing.inputs]

    def seen(pose, index):
        values = signals(pose, 0.0, reference.tick(index))
        return [values[i] for i in chosen]

    runner.tick(seen(there, 0))
    for tick in ticks:
        assert tick.command == runner.tick(seen(tick.estimate.pose, tick.index))
    # And it drives there, as the engine's rover does.
    assert distance(poses[-1], COURSE.goal) < 0.1
    trials = nominal_trials(default_rover(), COURSE.ticks)._replace(start=np.array([there]))
    simulated = rollout(tracker, COURSE, trials=trials).poses
    assert max(map(distance, poses, [Pose(*pose) for pose in simulated])) < 0.02


def test_the_verdict_is_the_courses_on_the_estimates():
    poses, _, controller = controlled()
    assert controller.verdict().reason.endswith("(at most 0.1 m)")
    controller.record_estimate(COURSE.ticks, COURSE.ticks * DT)
    assert controller.verdict().error_m == pytest.approx(distance(poses[-1], COURSE.goal), abs=0.03)


class Scripted:
    """A runner that has the given command in all ticks, or before tick ``stops``; keeps what it observes."""

    potentials = np.zeros(0)

    def __init__(self, command, stops=COURSE.ticks):
        self.command, self.stops, self.observed = command, stops, []

    def reset(self):
        self.observed = []

    def tick(self, observation):
        self.observed.append(tuple(observation))
        return (0.0, 0.0) if len(self.observed) > self.stops + 1 else self.command


@pytest.mark.parametrize("stops", [0, COURSE.ticks - 40, COURSE.ticks])
def test_a_rover_at_rest_at_the_end_sees_its_heading_error_alone(stops):
    runner, off = Scripted((0.1, 0.0), stops), Pose(-0.02, 0.04, 0.06)
    seen = ("longitudinal", "lateral", "heading")
    controller = Controller(seen, COURSE, EstimatorSettings(), runner=runner)
    controller.start(ORIGIN, -DT, compose(COURSE.goal, off))
    for index in range(COURSE.ticks):
        controller.estimator.odometry(ORIGIN, Velocity(0, 0), index * DT)
        controller.tick(index, index * DT)
    *_, before, moving = np.flatnonzero(plan_reference(COURSE).motion.any(axis=1))
    observed = runner.observed[1:]
    assert all(lateral != 0.0 for _, lateral, _ in observed[before:moving])
    rests = max(stops, moving + 1) + 1
    for longitudinal, lateral, heading in observed[rests:]:
        # Hidden is what the goal is to the side of its own axis; the rover is turned by 0.06 rad from it.
        assert (longitudinal, lateral, heading) == pytest.approx((0.02, 0.0, -0.06), abs=0.002)
    assert all(abs(lateral) > 0.03 for _, lateral, _ in observed[moving + 1 : rests])


@pytest.mark.parametrize(("gain", "sent"), [(7.4, 0.15), (2.0, 0.15), (1.2, 0.25), (0.5, 0.6), (-1.0, 0.6)])
def test_turn_commands_are_divided_by_a_possible_gain(gain, sent):
    policy = course_policy(load_circuit("tracking"))
    settings = EstimatorSettings.model_construct(**{**EstimatorSettings().model_dump(), "turn_gain": gain})
    controller = Controller(policy, COURSE, settings, runner=Scripted((0.0, 0.3)))
    controller.start(ORIGIN, 0.0)
    assert controller.tick(0, 0.0).command.omega == pytest.approx(sent)
