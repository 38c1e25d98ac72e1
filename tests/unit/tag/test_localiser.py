"""Pictures of a camera that works, and of cameras that do not."""

import math

import cv2
import pytest
from kit.tags import CAMERA, WALL, picture_of

from deploy.tag.cameras.camera import Picture
from deploy.tag.localiser import Localiser
from deploy.tag.locate import Rejection
from deploy.tag.tag_map import Tag, TagMap
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose

POSE = Pose(0.9, 0.05, 0.1)
SECOND_NS = 1_000_000_000


@pytest.fixture
def localiser():
    return Localiser(CAMERA, WALL)


def test_pose_of_a_good_picture(localiser):
    found = localiser.take(Picture(picture_of(POSE), SECOND_NS), 2 * SECOND_NS)
    assert found.pose.x == pytest.approx(POSE.x, abs=0.01)
    assert (localiser.pictures, localiser.poses, localiser.rejected) == (1, 1, {})
    assert "tags 7, 8, 9" in localiser.state


@pytest.mark.parametrize(
    ("pose", "gain", "age_s", "reason"),
    [
        (POSE, 0.0, 0, Rejection.DARK),
        (POSE, 12.0, 0, Rejection.BRIGHT),
        (Pose(0.9, 0.0, 3.0), 1.0, 0, Rejection.NO_TAG),
        (POSE, 1.0, 2, Rejection.OLD),
    ],
)
def test_picture_that_gives_no_pose_says_why(localiser, pose, gain, age_s, reason):
    picture = Picture(picture_of(pose, gain=gain), SECOND_NS)
    assert localiser.take(picture, (1 + age_s) * SECOND_NS) is None
    assert localiser.rejected == {reason: 1}


def test_frozen_camera_gives_no_more_poses(localiser):
    image = picture_of(POSE)
    got = [localiser.take(Picture(image, index * SECOND_NS // 4)) is not None for index in range(1, 9)]
    assert got == [True] + [False] * 7
    assert localiser.rejected == {Rejection.FROZEN: 7}
    assert localiser.take(Picture(picture_of(POSE, seed=2), 3 * SECOND_NS)) is not None


def test_other_resolution_than_the_calibrations_is_an_error(localiser):
    small = cv2.resize(picture_of(POSE), (320, 240))
    with pytest.raises(UsageError, match="sends 320 × 240 pixels, its calibration is for 640 × 480"):
        localiser.take(Picture(small, SECOND_NS))


def test_tag_that_is_printed_twice_is_named():
    localiser = Localiser(CAMERA, WALL.model_copy(update={"tags": WALL.tags[:1]}))
    twin = Tag(id=7, size=0.14, x=2.0, y=-0.2, z=0.3, yaw=math.pi)
    both = picture_of(POSE, tag_map=TagMap.model_construct(tags=(WALL.tags[0], twin)))
    assert localiser.take(Picture(both, SECOND_NS)) is None
    assert (localiser.rejected, localiser.twice) == ({Rejection.TWICE: 1}, {7})
