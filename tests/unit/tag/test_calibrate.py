"""Calibration from rendered pictures."""

import json
import math

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deploy.tag.board import board_map
from deploy.tag.calibrate import find_yaw
from deploy.tag.detector import Detection, Detector
from deploy.tag.locate import Locator
from deploy.tag.sheet import board_page
from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml, load_yaml
from rover_ncp.core.errors import UsageError
from rover_ncp.core.geometry import Pose, compose
from sim.camera.render import Renderer

TRUE = Intrinsics(width=640, height=480, fx=520.0, fy=520.0, cx=325.0, cy=236.0)


def board_pictures(count, tilt=0.5):
    """Pictures of a board that hangs at x = 0, seen from places to its sides by up to ``tilt`` rad."""
    tags = board_map(23, "letter").tags
    stream = np.random.default_rng(3)
    for index in range(count):
        angle, height = tilt * math.sin(2.1 * index), 0.24 * tilt * math.cos(1.3 * index)
        away = 0.28 + 0.05 * (index % 3)
        place = {"x": away * math.cos(angle), "y": away * math.sin(angle), "z": height}
        pitch, roll = math.atan2(height, away), 0.3 * math.sin(index)
        mount = Mount(**place, yaw=math.pi + angle, pitch=pitch, roll=roll)
        # The camera's place is all that moves: the rover stays at the origin.
        renderer = Renderer(CameraFile(intrinsics=TRUE, mount=mount), TagMap(tags=tags), stream)
        yield renderer.picture(Pose(0.0, 0.0, 0.0))


WALL = TagMap(
    tags=tuple(
        Tag(id=tag, size=0.14, x=2.0, y=y, z=z, yaw=math.pi)
        for tag, y, z in ((0, 0.5, 0.3), (1, 0.0, 0.35), (2, -0.5, 0.25))
    )
)
MOUNT = Mount(x=0.15, y=-0.03, z=0.3, yaw=0.04, pitch=0.05, roll=0.01)


def drive(*, metres=1.0, turn=0.0, heading=0.1):
    """The tags seen on a drive from rest to rest; ``turn`` is the change of heading in rad."""
    stream, locator = np.random.default_rng(5), Locator(CameraFile(intrinsics=TRUE, mount=MOUNT), WALL)
    pose, steps = Pose(0.0, 0.1, heading), 60
    for k in range(steps + 20):
        if 10 <= k < steps + 10:
            pose = compose(pose, Pose(metres / steps, 0.0, turn / steps))
        seen = []
        for tag in WALL.tags:
            exact = TRUE.fx * locator.project(np.array(pose), tag.corners) + (TRUE.cx, TRUE.cy)
            seen.append(Detection(tag.id, exact + stream.normal(0.0, 0.1, (4, 2))))
        yield seen


def written(folder, pictures):
    """Write pictures into a new folder, as a camera's program does."""
    folder.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{number:03}.png"), picture)
    return str(folder)


def test_camera_is_calibrated_from_pictures_and_its_file_keeps_what_is_not_measured(tmp_path, capsys):
    file, tags = tmp_path / "camera.yaml", tmp_path / "tags.yaml"
    tags.write_text(dump_yaml(WALL.model_dump(mode="json")))
    board = written(tmp_path / "board", board_pictures(12))
    calibrate = ["tag", "calibrate", "--camera-file", str(file), "--json", "--camera"]
    assert cli.run([*calibrate, board]) == 0
    result, found = json.loads(capsys.readouterr().out), load_yaml(file, CameraFile).intrinsics
    assert (result["pictures"], result["fx"]) == (12, found.fx)
    assert result["rms_px"] < 0.3
    assert (found.width, found.height) == (TRUE.width, TRUE.height)
    assert (found.fx, found.fy) == pytest.approx((TRUE.fx, TRUE.fy), rel=0.01)
    assert abs(found.fx - TRUE.fx) < 3.0 * result["fx_std"] < 0.01 * TRUE.fx
    assert (found.cx, found.cy) == pytest.approx((TRUE.cx, TRUE.cy), abs=5.0)

    by_hand = CameraFile(intrinsics=TRUE, mount=MOUNT.model_copy(update={"yaw": 0.0}), rate_hz=15.0)
    file.write_text(dump_yaml(by_hand.model_dump(mode="json", exclude_none=True)))
    renderer = Renderer(by_hand.model_copy(update={"mount": MOUNT}), WALL, np.random.default_rng(5))
    way = (renderer.picture(compose(Pose(0.0, 0.1, 0.1), Pose(0.05 * k, 0.0, 0.0))) for k in range(20))
    assert cli.run([*calibrate, written(tmp_path / "way", way), "--map", str(tags)]) == 0
    yaw = json.loads(capsys.readouterr().out)["yaw"]
    assert yaw == pytest.approx(MOUNT.yaw, abs=0.01)
    mount = MOUNT.model_copy(update={"yaw": yaw})
    assert load_yaml(file, CameraFile) == by_hand.model_copy(update={"mount": mount})

    before = file.read_bytes()
    larger = (cv2.resize(picture, (1280, 960)) for picture in [np.full((480, 640), 200, np.uint8)] * 3)
    assert cli.run([*calibrate, written(tmp_path / "larger", larger), "--map", str(tags)]) == 2
    assert "1280 × 960 pixels, its calibration is for 640 × 480" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_pictures_of_a_board_that_was_not_tilted_give_no_camera(tmp_path, capsys):
    file = tmp_path / "camera.yaml"
    board = written(tmp_path / "board", board_pictures(12, tilt=0.03))
    assert cli.run(["tag", "calibrate", "--camera-file", str(file), "--camera", board]) == 2
    assert "do not determine the focal length" in capsys.readouterr().err
    assert not file.exists()


def test_straight_drive_measures_the_yaw_of_the_mount():
    camera = CameraFile(intrinsics=TRUE, mount=MOUNT.model_copy(update={"yaw": 0.3}))
    found = find_yaw(camera, WALL, list(drive(turn=0.05)))
    assert found.yaw == pytest.approx(MOUNT.yaw, abs=max(3.0 * found.deviation, 0.001))
    assert found.deviation < 0.005


@pytest.mark.parametrize(
    ("way", "words"),
    [
        ({"metres": 0.5}, "drove 0.5. m, expected about 1 m"),
        ({"turn": 0.3}, "was not straight: it turned by 1[67]°"),
        ({"metres": 0.0}, "0.03 m apart, expected 10"),
        ({"metres": -1.0}, "from the file's: drive forward"),
    ],
)
def test_drive_that_does_not_determine_the_yaw_is_refused(way, words):
    with pytest.raises(UsageError, match=words):
        find_yaw(CameraFile(intrinsics=TRUE, mount=MOUNT), WALL, list(drive(**way)))


@pytest.mark.parametrize("page", ["a3", "letter"])
def test_tags_of_a_printed_board_are_where_its_map_has_them(page, monkeypatch):
    printed = []
    monkeypatch.setattr(
        "matplotlib.backends.backend_pdf.PdfPages.savefig", lambda _, page: printed.append(page)
    )
    board_page(17, page)
    known = {tag.id: tag.corners[:, 1:] for tag in board_map(17, page).tags}
    found = {
        each.id: each.corners * (1, -1) / 150 * 0.0254 for each in Detector().detect(grey(printed[0], 150))
    }
    assert found.keys() == known.keys()
    errors = np.concatenate([found[tag] - known[tag] for tag in known])
    assert np.ptp(errors, axis=0).max() < 6e-4


def grey(figure: Figure, dpi: int):
    """Draw a figure on grey levels."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, 0])
