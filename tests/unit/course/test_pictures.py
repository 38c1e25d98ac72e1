"""The data that the picture of a drive gets."""

import numpy as np
import pytest

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import load_course
from rover_ncp.course.pictures import drive_picture
from rover_ncp.course.reference import plan_reference


def test_drive_shows_where_the_reference_is_at_which_time():
    course = load_course("parking")
    reference = plan_reference(course)
    still = [Pose(0.0, 0.0, 0.0)] * 2
    figure = drive_picture(course, still, still)
    (axes,) = figure.axes
    lines = {line.get_label(): np.array(line.get_xydata()) for line in axes.lines}
    assert np.array_equal(lines["moving reference"], reference.poses[:, :2])
    at = {point.t: tuple(reference.at(point.t)[0])[:2] for point in course.checkpoints}
    assert lines["reference at these times"] == pytest.approx(np.array(list(at.values())))
    times = {text.get_text(): text.xy for text in axes.texts}
    (ninth,) = [place for t, place in at.items() if round(t) == 9]
    assert times["9 s"] == pytest.approx(ninth, abs=0.001)
