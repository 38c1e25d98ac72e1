"""A rover that no pose shows at the start of a docking turns on the spot until its tags are in view."""

import math

import numpy as np
import pytest
from kit.tags import CAMERA, WALL, picture_of
from kit.virtual_docking import BEFORE_STAGING, STAGING, VirtualDocking, place

from deploy.place.outcome import DockError
from deploy.place.plan import to_staging
from deploy.place.sight import SeenTag, Sight, blind, seen
from deploy.replay import replay
from deploy.tag.detector import Detector
from deploy.tag.field_of_view import sight_of
from deploy.tag.localiser import DECIMATE
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.wire.messages import point_cloud
from rover_ncp.wire.protocol import Fence

AWAY = BEFORE_STAGING._replace(theta=2.5)
TAGS = {"x": 2.5, "y": 1.0}


def ahead(pose, now):
    """What a camera sees that looks ahead, 30° to either side, at tags in the direction of the place."""
    bearing = math.atan2(TAGS["y"] - pose.y, TAGS["x"] - pose.x)
    return pose if abs(wrap_angle(bearing - pose.theta)) < math.radians(30.0) else None


def test_rover_turns_until_poses_come_and_docks(tmp_path):
    drive = VirtualDocking(place(), AWAY, path=tmp_path / "d.mcap", see=ahead)
    result = drive.run()
    assert (result.dock.success, result.exit_code) == (True, 0)
    assert math.hypot(*drive.off[:2]) < 0.02
    assert "searching" in [status.state for status in drive.link.statuses]
    assert replay(drive.path).same


def test_under_a_fence_the_rover_does_not_stay_turned_by_more_than_half_a_turn():
    """The fence lies in odometry's frame, which is turned by the errors of all turns of odometry."""
    headings = []

    def see(pose, now):
        headings.append(pose.theta)
        return ahead(pose, now)

    drive = VirtualDocking(place(), BEFORE_STAGING._replace(theta=1.0), see=see)
    drive.link.change_gate(fence=Fence(x_min=-5, x_max=5, y_min=-5, y_max=5))
    assert drive.run().dock.success
    assert max(np.unwrap(headings)) > 1.0 + math.pi
    assert abs(np.unwrap(headings)[-1]) < 0.1  # without the turn back it is 2π


def test_without_tags_the_rover_turns_once_and_stands_where_it_was():
    drive = VirtualDocking(place(), AWAY, see=lambda pose, now: None)
    result = drive.run()
    assert (result.exit_code, result.stopped_by) == (4, "start-pose")
    assert result.dock.error_code == DockError.FAILED_TO_DETECT_DOCK == 904
    assert "turned by 39" in result.dock.error_msg
    assert distance(drive.rover.pose, AWAY) < 0.05
    assert drive.stands()
    assert drive.link.released_ns is not None


def test_rover_does_not_turn_where_an_echo_is_in_the_circle_of_its_outline():
    drive = VirtualDocking(place(), AWAY, see=lambda pose, now: None)
    drive.link.put_with_odometry(
        "sonar", lambda odometry: [point_cloud([(0.0, 0.3, 0.2)], odometry.stamp_ns)]
    )
    result = drive.run()
    assert result.dock.error_code == DockError.FAILED_TO_DETECT_DOCK
    assert "0.30 m from its middle" in result.dock.error_msg
    assert drive.rover.pose == pytest.approx(AWAY, abs=0.02)


def test_rover_that_is_to_leave_its_place_does_not_turn_in_it():
    drive = VirtualDocking(place(), place().goal, see=lambda pose, now: None, undock=True)
    drive.run()
    assert "searching" not in [status.state for status in drive.link.statuses]


def test_way_keeps_the_tags_in_view_though_another_takes_less_time():
    start = Pose(1.9, 1.5, -math.pi / 2)
    ways = [to_staging(place(tags=tags), start)[0] for tags in (None, TAGS)]
    lost = [blind(place(tags=TAGS), way.reference, None) for way in ways]
    assert lost[1].seconds <= lost[0].seconds


def test_way_that_takes_longer_is_driven_where_the_other_would_lose_the_tags_for_almost_a_minute():
    """A rover that is slower than its plan would be stopped on the other way."""
    start, slow = Pose(0.73, 1.93, 2.82), 1.5
    direct, way = (to_staging(place(tags=tags), start, None, slow)[0] for tags in (None, TAGS))
    lost = [blind(place(tags=TAGS), each.reference, None).seconds for each in (direct, way)]
    assert lost[1] < 45.0 < lost[0] < 60.0


def test_way_that_loses_the_tags_for_a_minute_is_not_begun():
    slow, start = 12.0, STAGING._replace(theta=math.pi)
    assert to_staging(place(), start, None, slow)[0] is not None
    way, problems = to_staging(place(tags=TAGS), start, None, slow)
    assert way is None
    assert "loses the tags for" in str(problems[0])


def test_known_camera_decides_whether_a_way_loses_the_tags_and_where():
    slow, start = 12.0, STAGING._replace(theta=math.pi)
    tag = SeenTag(left=(2.5, 1.07), right=(2.5, 0.93))
    narrow, wide = (
        Sight(x=0.2, y=0.0, yaw=0.0, to_left=side, to_right=-side, tags=(tag,)) for side in (0.5, 3.1)
    )
    assert to_staging(place(), start, None, slow, sight=wide)[0] is not None
    way, problems = to_staging(place(), start, None, slow, sight=narrow)
    assert way is None
    assert "from x 1.30 m, y 1.00 m" in str(problems[0])
    behind = narrow.model_copy(update={"tags": (SeenTag(left=tag.right, right=tag.left),)})
    ahead = to_staging(place(), BEFORE_STAGING)[0].reference
    assert blind(place(), ahead, behind).seconds > blind(place(), ahead, narrow).seconds  # its back is seen


def test_view_of_a_camera_is_that_of_its_pictures():
    sight, detector = sight_of(CAMERA, WALL, place()), Detector(DECIMATE)
    poses = np.array([[0.9, 0.05, theta] for theta in np.arange(-0.9, 1.0, 0.05)])
    expected = seen(poses, sight)
    found = [bool(detector.detect(picture_of(Pose(*pose)))) for pose in poses]
    assert 15 < sum(found) < 30
    assert sum(expected != found) <= 2  # a tag at the edge of the picture
    assert sight_of(CAMERA, WALL.model_copy(update={"frame": "hall"}), place()) is None
