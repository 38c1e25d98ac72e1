"""Described robots in evaluations, and a fifth robot that is one YAML file."""

import numpy as np
import pytest
from kit.paths import DATA

from rover_ncp.cli import run
from rover_ncp.course.course import V_MAX, load_course
from rover_ncp.course.feasibility import check_course
from rover_ncp.course.reference import plan_reference
from rover_ncp.robot.description import load_description
from sim.evaluate.evaluate import _enlarged
from sim.learn.policies import any_policy
from sim.stack.trials import Stack
from sim.world.bodies import Body
from sim.world.described import described_rover, ranges_of
from sim.world.randomization import draw_trials
from sim.world.skid_robot import SkidRobot, rigid_body_of

BRIEF, ARC, FIFTH = (str(DATA / f"{name}.yaml") for name in ("brief_course", "arc_course", "fifth_robot"))


@pytest.mark.parametrize("name", ["turtlebot3-burger", "husky-a200", "p3at-sh"])
def test_trials_of_a_model_differ_as_its_description_says(name):
    robot = load_description(name)
    trials = draw_trials(ranges_of(robot), described_rover(robot), 1, count=300, ticks=10)
    delay_s = trials.delay[:, 0] * 0.01
    assert delay_s.min() == pytest.approx(robot.delays.v_s / 2, abs=0.011)
    assert delay_s.max() == pytest.approx(robot.delays.v_s * 2, abs=0.011)
    turned = trials.turning[:, 0]
    if robot.drive.kind == "skid":
        assert (turned.min(), turned.max()) == pytest.approx((0.75, 1.25), abs=0.01)
        assert trials.turning[:, 1].any()
    else:
        assert turned.min() == turned.max() == 1.0
    assert abs(trials.odometry[:, 0] - 1.0).max() == pytest.approx(0.03, abs=0.001)


def test_a_fast_reporting_robot_with_late_odometry_is_driven():
    """Fifty reports a second, each up to 50 ms late: their age is known from their stamps."""
    robot = load_description("jackal-j100")
    late = ranges_of(robot).model_copy(update={"jitter_s": 0.05})
    stack = Stack(any_policy("course"), (load_course(ARC),), late, 0, gyro=True, robot=robot)
    assert stack.drive(0).reason == ""


def test_a_skid_steered_robot_has_a_rigid_body_of_its_own():
    robot = load_description("husky-a200")
    assert rigid_body_of(load_description("p3at-sh")) == SkidRobot()
    ranges = ranges_of(robot, Body.MUJOCO)
    stack = Stack(any_policy("course"), (load_course(BRIEF),), ranges, 0, gyro=True, robot=robot)
    assert stack.drawn(0).rover.robot.mass_kg == pytest.approx(50.0, rel=0.21)
    assert stack.drive(0).parked


def test_a_fifth_robot_is_evaluated_from_its_file(run_json, capsys):
    code, fields = run_json(f"eval course --stack --course {BRIEF} --model {FIFTH}")
    assert (code, fields["success_rate"], fields["randomize"]) == (0, 1.0, "fifth")
    assert "1.6 times as long for fifth: fifth reaches 0.15 m/s" in fields["scaled"][0]
    assert run(["course", "check", BRIEF, "--model", FIFTH]) == 0
    assert "1.6 times as long for fifth" in capsys.readouterr().out


def test_a_course_with_obstacles_is_as_large_as_the_robot_asks_for():
    bay, husky = load_course("bay"), load_description("husky-a200")
    room = check_course(bay).clearance_m
    assert check_course(bay, husky).clearance_m < room / 2
    course, said = _enlarged(bay, husky)
    assert check_course(course, husky).clearance_m >= room
    assert np.abs(plan_reference(course).motion[:, 0]).max() <= V_MAX
    assert "bay is 1.582 times as large for husky-a200" in said
    assert course.parked == bay.parked
