"""Pictures of a path: what they show, and that the legend covers none of it."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from rover_ncp.core.geometry import Pose
from rover_ncp.course.course import load_course
from rover_ncp.course.feasibility import check_course
from rover_ncp.course.pictures import course_picture, drive_picture
from rover_ncp.course.reference import plan_reference


def legend_of(figure):
    """Return the words of the legend, after the check that it is outside the axes."""
    (axes,) = figure.axes
    FigureCanvasAgg(figure).draw()
    legend = axes.get_legend() or figure.legends[0]
    box, frame = legend.get_window_extent(), axes.get_window_extent()
    assert box.y1 <= frame.y0 or box.y0 >= frame.y1 or box.x0 >= frame.x1
    return [text.get_text() for text in legend.get_texts()]


def test_drive_shows_where_the_reference_is_at_which_time():
    course = load_course("parking")
    reference = plan_reference(course)
    still = [Pose(0.0, 0.0, 0.0)] * 2
    figure = drive_picture(course, still, still)
    assert {"moving reference", "reference at these times", "true path", "estimate"} <= set(legend_of(figure))
    (axes,) = figure.axes
    lines = {line.get_label(): np.array(line.get_xydata()) for line in axes.lines}
    assert np.array_equal(lines["moving reference"], reference.poses[:, :2])
    at = {point.t: tuple(reference.at(point.t)[0])[:2] for point in course.checkpoints}
    assert lines["reference at these times"] == pytest.approx(np.array(list(at.values())))
    times = {text.get_text(): text.xy for text in axes.texts}
    (ninth,) = [place for t, place in at.items() if round(t) == 9]
    assert times["9 s"] == pytest.approx(ninth, abs=0.001)


@pytest.mark.parametrize("name", ["bay", "reverse"])
def test_legend_of_a_course_covers_no_outline(name):
    course = load_course(name)
    assert "checkpoint, heading" in legend_of(course_picture(course, check_course(course)))
