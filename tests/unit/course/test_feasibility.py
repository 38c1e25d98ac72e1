"""Feasible and infeasible courses, and the reason reported for each."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.core.files import shipped_names
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.course.course import OMEGA_MAX, V_MAX, Checkpoint, Course, Obstacle, load_course
from rover_ncp.course.feasibility import Cause, check_course, clearance_at
from rover_ncp.robot.description import load_description
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, rover_body


def course_of(*points, horizon_s=20.0, obstacles=()):
    checkpoints = tuple(Checkpoint(t=t, x=x, y=y, theta=theta) for t, x, y, theta in points)
    return Course(
        name="test", start_signal_s=0.0, horizon_s=horizon_s, checkpoints=checkpoints, obstacles=obstacles
    )


AHEAD = ((0, 0, 0, 0), (8, 0.8, 0.0, 0.0), (14, 0.8, 0.0, 0.0))


@pytest.mark.parametrize("name", shipped_names("courses"))
def test_shipped_courses_can_be_driven(name):
    course = load_course(name)
    found = check_course(course)
    assert found.drivable, found.problems
    assert max(miss.error_m for miss in found.deviations) < 0.05
    assert max(found.deviations[-1].error_m, found.deviations[-1].error_rad) < 0.001
    assert (found.clearance_m is None) == (not course.obstacles)


def test_mirrored_is_the_papers_course_to_the_other_side():
    course, other = load_course("parking"), load_course("mirrored")
    for point, mirrored in zip(course.checkpoints, other.checkpoints, strict=True):
        assert (mirrored.t, mirrored.x) == (point.t, point.x)
        assert (mirrored.y, mirrored.theta) == (-point.y, -point.theta)


def test_the_clearance_is_that_of_the_simulators_rover():
    course = load_course("bay")
    found = check_course(course)
    assert 0.05 < found.clearance_m < 0.12
    ground = Ground(course.obstacles)
    body = rover_body(default_rover(), ground)
    (shape,) = body.shapes
    for wider, touches in ((-0.001, False), (0.001, True)):
        # The simulator's own collision detection, with every obstacle grown by the clearance.
        margin = found.clearance_m + wider
        touched = False
        for x, y, theta in found.reference.poses:
            body.position, body.angle = (x, y), theta
            ground.space.reindex_shapes_for_body(body)
            near = [
                other for other in ground.space.shapes if other is not shape and _apart(shape, other) < margin
            ]
            touched |= bool(near)
        assert touched == touches


def _apart(a, b):
    """The distance between two of pymunk's polygons, by its own query from each corner."""

    def corners(shape):
        return [shape.body.local_to_world(corner) for corner in shape.get_vertices()]

    return min(
        *(b.point_query(corner).distance for corner in corners(a)),
        *(a.point_query(corner).distance for corner in corners(b)),
    )


@pytest.mark.parametrize(
    ("points", "obstacles", "checkpoint", "cause", "words"),
    [
        (((5, 0.0, -0.5, 0.0), (14, 0.0, -0.5, 0.0)), (), 2, Cause.SIDEWAYS, "0.50 m to the right, 0.00 m"),
        (((2, 1.0, 0.0, 0.0), (14, 1.0, 0.0, 0.0)), (), 2, Cause.FAST, "0.50 m/s (at most 0.16 m/s)"),
        (((3, 0.0, 0.0, 2.0), (14, 0.0, 0.0, 2.0)), (), 2, Cause.TURN, "0.67 rad/s (at most 0.18 rad/s)"),
        (((20, 2.8, 0.0, 0.0),), (), 2, Cause.REST, "in the last 2 s"),
        (AHEAD[1:], (Obstacle(x=1.3, y=0.0, length=0.5, width=0.2),), 2, Cause.OBSTACLE, "obstacle 1 at"),
        (AHEAD[1:], (Obstacle(x=0.0, y=0.3, length=0.2, width=0.2),), 1, Cause.OBSTACLE, "obstacle 1 at 0.0"),
    ],
)
def test_where_and_why_a_course_cannot_be_driven(points, obstacles, checkpoint, cause, words):
    found = check_course(course_of((0, 0, 0, 0), *points, obstacles=obstacles))
    assert not found.drivable
    assert {problem.cause for problem in found.problems} == {cause}
    [shown] = [str(problem) for problem in found.problems if problem.checkpoint == checkpoint]
    assert shown.startswith(f"checkpoint {checkpoint} (")
    assert f" s): {cause.value}: " in shown
    assert words in shown


def test_a_course_that_begins_elsewhere_cannot_be_driven():
    found = check_course(course_of((0, 0.5, 0, 0), (8, 0.8, 0.0, 0.0), (14, 0.8, 0.0, 0.0)))
    assert [(problem.checkpoint, problem.cause) for problem in found.problems] == [(1, Cause.START)]


def test_first_heading_of_a_whole_turn_is_the_starts():
    whole = 2 * math.pi - 1e-4
    found = check_course(course_of((0, 0, 0, whole), (3, 0, 0, 0), (12, 0.8, 0, 0), (14, 0.8, 0, 0)))
    assert found.drivable, found.problems


@settings(max_examples=6, deadline=None)
@given(st.floats(0.2, 0.9), st.floats(-1.0, 1.0))
def test_an_arc_within_the_motors_limits_can_be_driven(length, turn):
    """Any arc, from rest to rest, in a time that leaves the motors room."""
    seconds = math.ceil(2.0 + 1.5 * max(length / V_MAX, abs(turn) / OMEGA_MAX))
    radius = length / turn if abs(turn) > 1e-6 else math.inf
    x = radius * math.sin(turn) if math.isfinite(radius) else length
    y = radius * (1 - math.cos(turn)) if math.isfinite(radius) else 0.0
    course = course_of((0, 0, 0, 0), (seconds, x, y, turn), (20, x, y, turn))
    found = check_course(course)
    assert found.drivable, found.problems
    end = Pose(*found.reference.poses[-1])
    assert distance(end, course.goal) < 0.025
    assert abs(wrap_angle(end.theta - turn)) < 0.025


def test_a_small_robot_clears_an_obstacle_that_a_larger_one_touches():
    course = course_of(*AHEAD, obstacles=(Obstacle(x=0.5, y=0.27, length=0.2, width=0.2),))
    assert check_course(course).clearance_m == 0.0
    found = check_course(course, load_description("turtlebot3-burger"))
    # The obstacle begins 0.17 m from the way; half the Burger's width is 0.105 m.
    assert found.clearance_m == pytest.approx(0.065, abs=1e-3)
    assert found.drivable


def test_the_outline_lies_around_the_centre_of_rotation():
    behind = course_of(
        (0, 0, 0, 0), (14, 0, 0, 0), obstacles=(Obstacle(x=-0.2, y=0.0, length=0.1, width=0.1),)
    )
    ahead = course_of((0, 0, 0, 0), (14, 0, 0, 0), obstacles=(Obstacle(x=0.2, y=0.0, length=0.1, width=0.1),))
    burger = load_description("turtlebot3-burger")
    assert check_course(behind, burger).clearance_m == pytest.approx(0.15 - 0.105)
    assert check_course(ahead, burger).clearance_m == pytest.approx(0.15 - 0.041)


@settings(max_examples=30)
@given(
    st.builds(
        Obstacle,
        x=st.floats(-0.5, 1.5),
        y=st.floats(-2.0, 2.0),
        theta=st.floats(-math.pi, math.pi),
        length=st.floats(0.05, 6.0),
        width=st.floats(0.05, 0.5),
    )
)
def test_an_obstacle_of_any_shape_counts_at_each_pose(obstacle):
    robot = load_description("turtlebot4")
    found = check_course(course_of(*AHEAD, obstacles=(obstacle,)), robot)
    gaps = [clearance_at(Pose(*pose), [obstacle], robot) for pose in found.reference.poses.tolist()]
    assert found.clearance_m == pytest.approx(min(gaps), abs=1e-9)
    assert any(problem.cause is Cause.OBSTACLE for problem in found.problems) == (min(gaps) == 0.0)
