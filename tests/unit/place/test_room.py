"""Ways under the gate's fence: plans stay inside it by odometry, and none that would leave it is begun."""

import math

from kit.virtual_docking import BEFORE_STAGING, VirtualDocking, place

from deploy.place.outcome import DockError
from deploy.place.plan import Fenced, approach, to_staging
from deploy.place.room import Room
from deploy.replay import replay
from rover_ncp.core.geometry import Pose, distance
from rover_ncp.wire.protocol import Fence

TURNED = Pose(0.5, 0.35, 2.76)
TIGHT = Fence(x_min=-0.35, x_max=2.35, y_min=0.0, y_max=1.35)


def fenced(fence, odometry, turn_gain):
    return Fenced(Room(fence=fence), odometry, turn_gain, approach(place()))


def under(fence, start, **settings):
    """Return a docking whose bridge tells of a fence."""
    drive = VirtualDocking(place(), start, **settings)
    drive.link.change_gate(fence=fence)
    return drive


def test_plan_takes_another_way_where_odometry_would_leave_the_fence():
    """Odometry shows less turn than there is: after the long turn to the left, the rest lies outside."""
    room = fenced(TIGHT, TURNED, turn_gain=1.4)
    shortest, _ = to_staging(place(), TURNED)
    inside, _ = to_staging(place(), TURNED, fenced=room)
    true_odometry, _ = to_staging(place(), TURNED, fenced=fenced(TIGHT, TURNED, turn_gain=1.0))
    assert room.fit(shortest).left is not None
    assert (room.fit(inside).left, room.fit(inside).risk) == (None, 0)
    assert true_odometry.course == shortest.course


def test_fence_lies_where_odometry_is():
    """The same fence with odometry that began elsewhere, turned by a quarter, is another one."""
    shortest, _ = to_staging(place(), BEFORE_STAGING)
    room = fenced(TIGHT, BEFORE_STAGING, 1.0)
    elsewhere = fenced(TIGHT, BEFORE_STAGING._replace(theta=BEFORE_STAGING.theta + math.pi / 2), 1.0)
    assert (room.fit(shortest).left, room.fit(shortest).risk) == (None, 0)
    assert elsewhere.fit(shortest).left is not None


def test_way_keeps_away_from_the_fence_unless_it_takes_much_longer():
    near = {}
    for start in (Pose(0.77, 2.18, 0.48), Pose(0.87, 1.25, -1.58)):
        room = fenced(Fence(x_min=0.17, x_max=2.6, y_min=0.6, y_max=start.y + 0.4), start, turn_gain=1.0)
        direct, way = to_staging(place(), start)[0], to_staging(place(), start, fenced=room)[0]
        near[start] = room.fit(direct).near, room.fit(way).near
        assert way.course.horizon_s < direct.course.horizon_s + 20.0
    assert list(near.values()) == [(True, False), (True, True)]


def test_docking_without_a_way_inside_the_fence_does_not_begin():
    drive = under(Fence(x_min=-0.3, x_max=0.3, y_min=-0.3, y_max=0.3), BEFORE_STAGING)
    result = drive.run()
    assert (result.stopped_by, result.dock.error_code) == ("start-pose", DockError.FAILED_TO_STAGE)
    assert "leaves the gate's fence (x -0.3 to 0.3 m, y -0.3 to 0.3 m in odom" in result.dock.error_msg
    assert distance(drive.rover.pose, BEFORE_STAGING) < 0.01


def test_docking_inside_a_fence_is_replayed(tmp_path):
    drive = under(Fence(x_min=-1, x_max=2, y_min=-1, y_max=2), BEFORE_STAGING, path=tmp_path / "d.mcap")
    assert drive.run().dock.success
    assert replay(drive.path).same


def test_rover_outside_the_fence_does_not_turn_to_look_for_tags():
    outside = Fence(x_min=1, x_max=2, y_min=1, y_max=2)
    drive = under(outside, BEFORE_STAGING, see=lambda pose, now: None)
    result = drive.run()
    assert result.dock.error_code == DockError.FAILED_TO_DETECT_DOCK
    assert "did not turn" in result.dock.error_msg
    assert drive.rover.pose == BEFORE_STAGING
