"""The shipped courses can be driven, and the bay is a bay."""

import numpy as np
import pytest

from rover_ncp.core.files import shipped_names
from rover_ncp.course.course import load_course
from rover_ncp.course.reference import deviations, plan_reference
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, rover_body


@pytest.mark.parametrize("name", shipped_names("courses"))
def test_the_reference_ends_on_the_goal_and_stays_near_the_checkpoints(name):
    course = load_course(name)
    found = deviations(course, plan_reference(course))
    assert max(miss.error_m for miss in found) < 0.05
    assert found[-1].error_m < 0.001
    assert found[-1].error_rad < 0.001


def test_mirrored_is_the_papers_course_to_the_other_side():
    course, other = load_course("parking"), load_course("mirrored")
    for point, mirrored in zip(course.checkpoints, other.checkpoints, strict=True):
        assert (mirrored.t, mirrored.x) == (point.t, point.x)
        assert (mirrored.y, mirrored.theta) == (-point.y, -point.theta)


def test_the_way_into_the_bay_is_free_and_narrow():
    course = load_course("bay")
    poses = plan_reference(course).poses

    def touches(shift_y):
        ground = Ground(course.obstacles)
        body = rover_body(default_rover(), ground)
        for x, y, theta in poses:
            body.position, body.angle = (x, y + shift_y), theta
            ground.space.reindex_shapes_for_body(body)
            if any(ground.space.shape_query(shape) for shape in body.shapes):
                return True
        return False

    assert not touches(0.0)
    assert touches(0.25)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).sum() > 0.8
