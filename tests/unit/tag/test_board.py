"""Poses by a board that hangs at a height and a tilt that were not measured."""

import math

import numpy as np
import pytest
from kit.tags import CAMERA, picture_of

from deploy.tag.board import board_map, board_of
from deploy.tag.board_locator import locator
from deploy.tag.detector import Detector
from deploy.tag.locate import Rejection
from deploy.tag.tag_map import Mount, Tag, TagMap
from rover_ncp.core.geometry import Pose, distance, relative, wrap_angle

BOARD = board_map(17, "a4")


def hung(board, *, z=0.45, pitch=0.0, roll=0.0, y=0.0):
    """Return a board's tags in the room, where its middle is at height ``z``."""
    turn = Mount(x=0.0, y=0.0, z=0.0, pitch=pitch, roll=roll).rotation
    placed = []
    for tag in board.tags:
        x, right, up = turn @ tag.position + (0.0, y, z)
        at = {"x": x, "y": right, "z": up, "pitch": pitch, "roll": roll}
        placed.append(tag.model_copy(update=at))
    return TagMap(tags=tuple(placed))


def before(away, bearing=0.2, turn=0.05):
    """Return a pose of the base from which the board is in the middle of the picture, about."""
    return Pose(away * math.cos(bearing), away * math.sin(bearing), math.pi + bearing + turn)


def by(board, room, pose, camera=CAMERA, seed=1):
    """Return what the board tells of a picture of the room."""
    picture = picture_of(pose, CAMERA, room, seed=seed)
    return locator(camera, board).locate(Detector(2.0).detect(picture))


@pytest.mark.parametrize("away", [0.45, 1.5])
def test_pose_by_a_board_needs_no_height(away):
    true = before(away)
    found = by(BOARD, hung(BOARD, z=0.4), true)
    assert distance(found.pose, true) < max(0.01, 0.012 * away**2)
    assert abs(wrap_angle(found.pose.theta - true.theta)) < 0.02
    assert distance(found.pose, true) < 4.0 * math.sqrt(np.trace(found.covariance[:2, :2]))


def test_mount_that_is_wrong_moves_all_poses_by_one_motion_in_the_rovers_frame():
    error = {"x": CAMERA.mount.x + 0.02, "y": CAMERA.mount.y - 0.02, "yaw": CAMERA.mount.yaw + 0.035}
    wrong = CAMERA.model_copy(update={"mount": CAMERA.mount.model_copy(update=error)})
    moves = []
    for true in (before(0.5), before(0.5, bearing=-0.3), before(0.7, turn=-0.1)):
        moves.append(relative(true, by(BOARD, hung(BOARD), true, wrong).pose))
    assert abs(moves[0].theta) == pytest.approx(0.035, abs=0.003)
    assert np.ptp(moves, axis=0).max() < 0.004


def test_frame_tells_boards_apart():
    frames = {board_map(number, page).frame for number in (1, 57) for page in ("a4", "a3", "letter")}
    assert len(frames) == 6
    assert by(board_map(18, "a4"), hung(BOARD), before(0.8)) is Rejection.NO_TAG
    assert board_of(BOARD.frame) == BOARD
    assert [board_of(name) for name in ("board-0-a4", "board-58-a4", "board-17-a5")] == [None] * 3


def test_pose_is_by_the_own_board_though_another_hangs_beside_it():
    other = hung(board_map(18, "a4"), y=0.35)
    room = TagMap(tags=hung(BOARD).tags + other.tags)
    found = by(BOARD, room, before(1.2))
    assert distance(found.pose, before(1.2)) < 0.015
    assert set(found.ids) <= {tag.id for tag in BOARD.tags}


def test_board_that_hangs_sideways_gives_no_pose():
    assert by(BOARD, hung(BOARD, roll=math.pi / 2), before(0.8)) is Rejection.TILTED


@pytest.mark.parametrize(("away", "places"), [(0.7, True), (2.6, False)])
def test_single_tag_gives_a_pose_only_where_its_two_poses_can_be_told_apart(away, places):
    tag = TagMap(frame="tag", tags_on="board", tags=(Tag(id=3, size=0.14, x=0.0, y=0.0, z=0.0),))
    true = before(away)
    found = by(tag, hung(tag, z=0.3), true)
    assert found is Rejection.AMBIGUOUS if not places else distance(found.pose, true) < 0.02
