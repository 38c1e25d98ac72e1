"""Poses from rendered pictures, whose true pose is known."""

import math

import numpy as np
import pytest
from kit.tags import CAMERA, PICTURE, WALL, picture_of

from deploy.tag.detector import Detector
from deploy.tag.locate import Locator, Rejection
from deploy.tag.tag_map import CameraFile, Mount, Tag, TagMap
from rover_ncp.core.geometry import Pose, wrap_angle

POSE = Pose(0.9, 0.0, 0.0)
CEILING = CameraFile(intrinsics=PICTURE, mount=Mount(x=1.0, y=0.5, z=2.5, yaw=0.3, pitch=math.pi / 2))
ON_ROVER = TagMap(
    tags_on="rover", tags=(Tag(id=3, size=0.2, x=-0.05, y=0.02, z=0.4, yaw=0.2, pitch=-math.pi / 2),)
)


def located(camera, drawn, known, pose):
    return Locator(camera, known).locate(Detector().detect(picture_of(pose, camera, drawn)))


def with_tag(tag_map, index, **changes):
    tags = list(tag_map.tags)
    tags[index] = tags[index].model_copy(update=changes)
    return tag_map.model_copy(update={"tags": tuple(tags)})


@pytest.mark.parametrize("pose", [Pose(0.9, 0.05, 0.1), Pose(0.3, 0.1, 0.05)])
def test_camera_on_the_rover_finds_the_pose(pose):
    found = located(CAMERA, WALL, WALL, pose)
    assert found.ids == (7, 8, 9)
    assert math.dist(found.pose[:2], pose[:2]) < 0.01
    assert abs(wrap_angle(found.pose.theta - pose.theta)) < math.radians(0.6)
    error = np.array(found.pose) - pose
    assert error @ np.linalg.inv(found.covariance) @ error < 11.3  # 99 % of a chi-squared of 3


@pytest.mark.parametrize("pose", [Pose(0.8, 0.3, 0.0), Pose(1.3, 0.7, 2.0)])
def test_camera_on_the_ceiling_finds_the_pose_in_every_direction(pose):
    found = located(CEILING, ON_ROVER, ON_ROVER, pose)
    assert math.dist(found.pose[:2], pose[:2]) < 0.008
    assert abs(wrap_angle(found.pose.theta - pose.theta)) < math.radians(0.6)


@pytest.mark.parametrize("wrong", [{"size": 0.10}, {"y": 0.08}, {"yaw": 2.6}])
def test_one_wrong_tag_of_three_is_left_out(wrong):
    found = located(CAMERA, WALL, with_tag(WALL, 2, **wrong), POSE)
    assert found.ids == (7, 8)
    assert math.dist(found.pose[:2], POSE[:2]) < 0.01


TWO = WALL.model_copy(update={"tags": WALL.tags[:2]})
HIGH = TagMap(tags=(Tag(id=7, size=0.14, x=1.9, y=0.0, z=0.6, yaw=math.pi),))
OTHERS = ON_ROVER.model_copy(update={"tags_on": "ground"})


@pytest.mark.parametrize(
    ("drawn", "known", "reason"),
    [
        pytest.param(TWO, with_tag(TWO, 0, y=0.3), Rejection.DISAGREE, id="two that contradict each other"),
        pytest.param(HIGH, with_tag(HIGH, 0, size=0.10), Rejection.MISFIT, id="one of a wrong size"),
        pytest.param(WALL, OTHERS, Rejection.NO_TAG, id="none of the map"),
    ],
)
def test_tags_that_give_no_pose(drawn, known, reason):
    assert located(CAMERA, drawn, known, POSE) is reason
