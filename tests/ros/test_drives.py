"""A robot of real ROS 2, checked and parked: two ways by which its topics reach Zenoh."""

import math

import pytest
from ros.rig import MODEL, RosRun

from deploy.replay import replay
from rover_ncp.core.geometry import Pose, distance, relative
from rover_ncp.course.course import load_course

PARKED_M = 0.1


def true_pose(robot):
    return Pose(*(robot.last[name] for name in ("x", "y", "theta")))


@pytest.mark.parametrize("way", ["rclpy", "pyzeros"])
def test_a_robot_parks_and_the_recording_replays(way, tmp_path):
    with RosRun(tmp_path, way=way) as run:
        begin, drive = true_pose(run.body), tmp_path / "run.mcap"
        done = run.deploy("--model", MODEL, "--course", "parking", "--record", str(drive)).wait(120.0)
        assert done.code == 0, done.last_line
        assert done.result["verdict"] == "parked"
        reached = relative(begin, true_pose(run.body))
        goal = load_course("parking").goal
        assert distance(reached, goal) < PARKED_M
        assert math.remainder(reached.theta - goal.theta, math.tau) == pytest.approx(0.0, abs=PARKED_M)
        assert run.bridge.stop().code == 0
    assert replay(drive).difference is None
