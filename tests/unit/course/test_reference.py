import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import OMEGA_MAX, TICK_S, V_MAX, Checkpoint, Course, load_course
from rover_ncp.course.reference import deviations, drive_profile, plan_reference
from rover_ncp.course.signals import REFERENCE_SIGNALS, SIGNALS, signals


def course_of(*points, horizon_s=20.0):
    checkpoints = tuple(Checkpoint(t=t, x=x, y=y, theta=theta) for t, x, y, theta in points)
    return Course(name="test", start_signal_s=0.0, horizon_s=horizon_s, checkpoints=checkpoints)


def require_drivable(reference):
    """The reference is the drive that its own motion makes, within the motors' limits, step by step."""
    poses, motion = reference.poses, reference.motion
    assert (np.abs(motion[:, 0]) <= V_MAX + 1e-9).all()
    assert (np.abs(motion[:, 1]) <= OMEGA_MAX + 1e-9).all()
    fine = 20
    v, omega = (
        np.interp(np.arange(fine * reference.ticks) + 0.5, fine * np.arange(reference.ticks + 1), column)
        for column in motion.T
    )
    dt = TICK_S / fine
    theta = poses[0, 2] + np.concatenate([[0.0], np.cumsum(omega) * dt])
    heading = 0.5 * (theta[1:] + theta[:-1])
    x = poses[0, 0] + np.concatenate([[0.0], np.cumsum(v * np.cos(heading)) * dt])
    y = poses[0, 1] + np.concatenate([[0.0], np.cumsum(v * np.sin(heading)) * dt])
    assert np.allclose(np.column_stack([x, y, theta])[::fine], poses, atol=1e-4)


@pytest.fixture(scope="module")
def parking():
    course = load_course("parking")
    return course, plan_reference(course)


def test_the_papers_course_is_followed_as_far_as_it_can_be_driven(parking):
    course, reference = parking
    require_drivable(reference)
    found = deviations(course, reference)
    # The checkpoints contradict each other: some ask for 0.196 rad/s, some for a heading across the path.
    assert max(miss.error_m for miss in found) < 0.05
    assert max(miss.error_rad for miss in found) < 0.07
    assert max(miss.error_m for miss in found[-6:]) < 0.0005
    assert max(miss.error_rad for miss in found[-6:]) < 0.001


def test_the_rover_rests_before_the_start_signal_and_from_the_goal_on(parking):
    _, reference = parking
    assert not reference.motion[:30].any()
    assert not reference.motion[165:].any()
    assert (np.ptp(reference.poses[165:], axis=0) == 0).all()
    assert (reference.motion[:, 0] >= 0).all()


def found_again(knots):
    """Return a drive through knots (v, omega), 0.5 s apart, and the reference of its checkpoints."""
    knots = np.array(knots)
    ticks = np.arange(5 * (len(knots) - 1) + 1) / 5
    v, omega = (np.interp(ticks, np.arange(len(knots)), column) for column in knots.T)
    drive = drive_profile(Pose(0, 0, 0), v.tolist(), omega.tolist())
    require_drivable(drive)
    horizon = round(0.1 * drive.ticks, 1)
    points = [(t, *drive.at(t)[0]) for t in [*np.arange(0.0, horizon, 1.0), horizon]]
    found = plan_reference(course_of(*points, horizon_s=horizon))
    require_drivable(found)
    return drive, found


def test_a_drive_that_changes_direction_is_found_again():
    pieces, rest = [(-0.15, 0.1), (0.15, 0.1), (-0.15, -0.17), (0.1, 0.0)], [(0.0, 0.0)] * 4
    moving = [knot for piece in pieces for knot in [*[piece] * 8, (0.0, 0.0)]]
    drive, found = found_again([*rest, *moving, *rest])
    assert np.hypot(*(found.poses - drive.poses)[-1, :2]) < 0.001
    assert np.hypot(*(found.poses - drive.poses)[:, :2].T).max() < 0.02
    assert np.abs(found.motion[:, 0] - drive.motion[:, 0]).max() < 0.06


@settings(max_examples=settings().max_examples // 3)
@given(st.lists(st.tuples(st.floats(0, 0.15), st.floats(-0.17, 0.17)), min_size=2, max_size=6))
def test_a_drive_is_found_again_from_its_checkpoints(pieces):
    drive, found = found_again([(0.0, 0.0), *np.repeat(np.array(pieces), 5, axis=0), *[(0.0, 0.0)] * 4])
    assert np.hypot(*(found.poses - drive.poses)[-1, :2]) < 0.003
    assert np.hypot(*(found.poses - drive.poses)[:, :2].T).max() < 0.04


def test_the_rover_rests_at_a_goal_that_is_due_long_after_it_can_be_there():
    arc = [(t, math.sin(0.12 * t), 1 - math.cos(0.12 * t), 0.12 * t) for t in range(1, 10)]
    x, y, theta = arc[-1][1:]
    goal = x + 0.03 * math.cos(theta), y + 0.03 * math.sin(theta), theta
    reference = plan_reference(course_of((0, 0, 0, 0), *arc, (20, *goal)))
    require_drivable(reference)
    resting = 10 * (9 + 3)  # 2 s to stop, and the last 3 cm
    assert not reference.motion[resting:].any()
    assert np.abs(reference.poses[resting] - goal).max() < 0.001


def test_signals_have_their_names(parking):
    _, reference = parking
    seen = dict(zip(SIGNALS, signals(Pose(0.1, 0.2, 0.3), 1.0, reference.tick(100)), strict=True))
    assert (seen["x"], seen["y"], seen["theta"], seen["start"]) == (0.1, 0.2, 0.3, 1.0)
    assert seen["heading"] == pytest.approx(reference.poses[100, 2] - 0.3)
    assert (seen["speed"], seen["turn"]) == tuple(reference.motion[100])
    without = dict(zip(SIGNALS, signals(Pose(0.1, 0.2, 0.3), 0.0, None), strict=True))
    assert all(without[name] == 0.0 for name in REFERENCE_SIGNALS)
