"""The file of a place, the ways to it, and the survey of poses."""

import math

import numpy as np
import pytest
from kit.virtual_docking import place

from deploy.drive.measurements import pose_reader
from deploy.place.plan import approach, in_the_way, retreat, to_staging
from deploy.place.survey import blurred, complaint, set_place, survey
from rover_ncp.core.errors import ConfigError, FormatError, UsageError
from rover_ncp.core.geometry import ORIGIN, Pose, distance, wrap_angle
from rover_ncp.course.course import OMEGA_MAX, V_MAX
from rover_ncp.course.feasibility import Cause, check_course
from rover_ncp.wire.messages import PoseSample, pose_with_covariance

DIRECTIONS = "forward", "backward"
STARTS = Pose(0.0, 0.0, 0.0), Pose(1.5, 1.0, -3.1)


def ends_at(way, base):
    """Return whether a way leads to a pose of the base."""
    end = Pose(*way.reference.poses[-1].tolist())
    return distance(end, base) < 1e-6 and abs(wrap_angle(end.theta - base.theta)) < 0.03


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("start", STARTS)
def test_way_from_any_heading_is_drivable_and_ends_at_the_staging_pose(start, direction):
    where = place(direction=direction)
    way, problems = to_staging(where, start)
    assert problems == ()
    assert ends_at(way, where.staging)
    speeds = np.abs(way.reference.motion).max(axis=0)
    assert (speeds < [V_MAX, OMEGA_MAX]).all()
    assert check_course(way.course, reference=way.reference).drivable


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_approach_ends_at_the_place_slowly_and_retreat_at_the_staging_pose(direction):
    where = place(direction=direction)
    way, back = approach(where), retreat(where)
    assert ends_at(way, where.goal)
    assert ends_at(back, where.staging)
    assert (way.backward, back.backward) == (where.backward, not where.backward)
    left_m = np.hypot(*(way.reference.poses[:, :2] - [2.0, 1.0]).T)
    assert np.abs(way.reference.motion[left_m < 0.29, 0]).max() <= 0.0401
    assert way.course.goal == where.goal


def test_ways_of_a_very_slow_robot_are_courses_until_they_take_too_long():
    way, _ = to_staging(place(), STARTS[0], None, 36.0)
    assert 1000.0 < way.course.horizon_s < 1800.0
    with pytest.raises(UsageError, match=r"bay: one way would take \d{4} s \(at most 3600 s\)"):
        to_staging(place(), STARTS[0], None, 100.0)


def test_obstacle_on_the_approach_is_named_and_the_dock_itself_is_not():
    lane, dock = ({"x": x, "y": 1.0, "length": 0.1, "width": 0.6} for x in (1.75, 2.365))
    where = place(obstacles=[dock, lane])
    assert in_the_way(where, approach(where)).startswith("the approach touches obstacle 2, 0.6")
    assert in_the_way(place(obstacles=[dock]), approach(where)) == ""
    assert in_the_way(place(direction="backward", obstacles=[lane | {"x": 1.5}]), approach(BACKWARD)) == ""


BACKWARD = place(direction="backward")


def test_obstacle_in_the_way_leads_to_a_detour_and_one_at_the_staging_pose_to_a_reason():
    start, wall = Pose(-0.5, 1.0, 0.0), {"x": 0.5, "y": 1.0, "length": 0.2, "width": 0.4}
    direct, _ = to_staging(place(), start)
    around, problems = to_staging(place(obstacles=[wall]), start)
    assert problems == ()
    assert around.course.horizon_s > direct.course.horizon_s
    none, problems = to_staging(place(obstacles=[wall | {"x": 1.3}]), start)
    assert none is None
    assert problems[0].cause is Cause.OBSTACLE


def samples(poses, frame="map"):
    return [PoseSample(0, frame, Pose(*pose), np.zeros((3, 3))) for pose in poses]


def test_survey_takes_the_median_across_the_angle_where_headings_wrap():
    noise = np.random.default_rng(1).normal(size=(40, 3)) * [0.002, 0.004, 0.01]
    poses = np.array([1.0, 2.0, math.pi]) + noise
    poses[7] = [9.0, 9.0, 0.0]  # one that is no view of this place
    seen = survey(samples(poses), 5.0)
    assert seen.pose == pytest.approx((1.0, 2.0, seen.pose.theta), abs=0.003)
    assert abs(wrap_angle(seen.pose.theta - math.pi)) < 0.006
    assert seen.scatter.poses == 40


def test_check_names_a_dock_that_was_moved_and_another_frame():
    where, there = place(), [(2.0, 1.0, 0.0)] * 20
    assert complaint(where, survey(samples(there), 5.0)) == ""
    moved = survey(samples([(2.0, 1.05, 0.0)] * 20), 5.0)
    assert "+50 mm to the left" in complaint(where, moved)
    assert "frame 'odom'" in complaint(where, survey(samples(there, "odom"), 5.0))
    rough = np.array(there) + np.random.default_rng(1).normal(size=(20, 3)) * [0.03, 0.03, 0.0]
    assert blurred(where, survey(samples(rough), 5.0).scatter)
    assert not blurred(where, survey(samples(there), 5.0).scatter)


def test_obstacles_are_not_taken_over_into_another_frame():
    known = place(obstacles=[{"x": 3.0, "y": 1.0, "length": 0.2, "width": 0.2}]).model_dump()
    seen = [survey(samples([(2.0, 1.1, 0.0)] * 20, frame), 5.0) for frame in ("map", "board-17-a4")]
    again = set_place(known, seen[0], "home.yaml")
    assert (again.pose.y, len(again.obstacles)) == (1.1, 1)
    with pytest.raises(ConfigError, match=r"home.yaml: its obstacles are in frame 'map'"):
        set_place(known, seen[1], "home.yaml")
    assert set_place(known | {"obstacles": ()}, seen[1], "home.yaml").frame == "board-17-a4"


def test_pose_of_another_frame_names_both_frames():
    data = pose_with_covariance(ORIGIN, np.eye(3), 0, "odom")
    with pytest.raises(FormatError, match="pose in frame 'odom', expected 'map'"):
        pose_reader("map")(data)
    for frame in ("map", "robot1/map", ""):
        pose_reader("map")(pose_with_covariance(ORIGIN, np.eye(3), 0, frame))
