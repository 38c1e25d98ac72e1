"""Calibration from rendered pictures."""

import math

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deploy.tag.calibrate import find_intrinsics, find_mount
from deploy.tag.detector import Detection, Detector
from deploy.tag.locate import Locator
from deploy.tag.sheet import BOARD, BOARD_TAG_M, board_page, tag_pages
from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap, load_camera_info
from rover_ncp import cli
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.errors import ConfigError, UsageError
from rover_ncp.core.geometry import Pose, compose, relative
from sim.camera.render import Renderer

TRUE = Intrinsics(width=640, height=480, fx=520.0, fy=520.0, cx=325.0, cy=236.0)


def board_pictures(count):
    """Pictures of a board that hangs at x = 0, seen from tilted places."""
    tags = tuple(
        Tag(id=tag, size=BOARD_TAG_M, x=0.0, y=x - 0.066, z=0.088 + y, yaw=0.0)
        for tag, (x, y) in enumerate(BOARD)
    )
    stream = np.random.default_rng(3)
    for index in range(count):
        angle, height = 0.5 * math.sin(2.1 * index), 0.12 * math.cos(1.3 * index)
        away = 0.28 + 0.05 * (index % 3)
        place = {"x": away * math.cos(angle), "y": away * math.sin(angle), "z": height}
        pitch, roll = math.atan2(height, away), 0.3 * math.sin(index)
        mount = Mount(**place, yaw=math.pi + angle, pitch=pitch, roll=roll)
        # The camera's place is all that moves: the rover stays at the origin.
        renderer = Renderer(CameraFile(intrinsics=TRUE, mount=mount), TagMap(tags=tags), stream)
        yield Detector().detect(renderer.picture(Pose(0.0, 0.0, 0.0)))


def test_intrinsics_come_back_from_pictures_of_the_board():
    found = find_intrinsics(list(board_pictures(12)), (640, 480))
    assert found.pictures == 12
    assert found.rms < 0.3
    assert (found.intrinsics.fx, found.intrinsics.fy) == pytest.approx((TRUE.fx, TRUE.fy), rel=0.01)
    assert (found.intrinsics.cx, found.intrinsics.cy) == pytest.approx((TRUE.cx, TRUE.cy), abs=5.0)


def test_too_few_pictures_of_the_board_are_refused():
    with pytest.raises(UsageError, match="seen well in 2 of 3 pictures"):
        find_intrinsics([*board_pictures(2), []], (640, 480))


def test_pictures_of_two_sizes_are_refused(tmp_path, capsys):
    for index, width in enumerate((640, 320)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.zeros((width * 3 // 4, width), np.uint8))
    camera = tmp_path / "camera.yaml"
    assert cli.run(["tag", "calibrate", "--camera", str(tmp_path), "--camera-file", str(camera)]) == 2
    assert "pictures of 640 × 480 and 320 × 240 pixels, expected one size" in capsys.readouterr().err
    assert not camera.exists()


WALL = TagMap(
    tags=tuple(
        Tag(id=tag, size=0.14, x=2.0, y=y, z=z, yaw=math.pi)
        for tag, y, z in ((0, 0.5, 0.3), (1, 0.0, 0.35), (2, -0.5, 0.25))
    )
)
MOUNT = Mount(x=0.15, y=-0.03, z=0.3, yaw=0.04, pitch=0.05, roll=0.01)


def drive(turn, gain=1.0, late_s=0.0, step_rad=1e-6):
    """Odometry, which begins at another place and heading than the map, and what is seen, both with moments.

    ``gain`` is odometry's turn over the true one. Pictures have moments that are ``late_s`` after the true.
    Headings of odometry are multiples of ``step_rad``.
    """
    stream, locator = np.random.default_rng(5), Locator(CameraFile(intrinsics=TRUE, mount=MOUNT), WALL)
    path = [Pose(0.4, 0.1, 0.1)]
    for k in range(240):
        rate = turn * 0.5 * math.cos(0.05 * k)
        path.append(compose(path[-1], Pose(0.003, 0.0, 0.1 * rate)))
    odometry = [Pose(3.0, -1.0, 3.0)]  # headings wrap
    for step in map(relative, path, path[1:]):
        odometry.append(compose(odometry[-1], step._replace(theta=gain * step.theta)))
    pictures = []
    for k in range(4, 236, 5):
        seen = []
        for tag in WALL.tags:
            exact = TRUE.fx * locator.project(np.array(path[k]), tag.corners) + (TRUE.cx, TRUE.cy)
            seen.append(Detection(tag.id, exact + stream.normal(0.0, 0.1, (4, 2))))
        pictures.append((round((0.1 * k + late_s) * 1e9), seen))
    rounded = [pose._replace(theta=step_rad * round(pose.theta / step_rad)) for pose in odometry]
    return [(round(0.1 * k * 1e9), pose) for k, pose in enumerate(rounded)], pictures


@pytest.mark.parametrize(
    ("gain", "late_s", "step_rad"),
    [(1.0, 0.0, 1e-6), (1.2, 0.0, 1e-6), (1.0, 0.03, 1e-6), (1.0, 0.0, math.tau / 4096)],
    ids=["exact", "slip", "late", "steps of a Pioneer"],
)
def test_mount_comes_back_from_a_drive_with_turns(gain, late_s, step_rad):
    by_hand = MOUNT.model_copy(update={"x": 0.18, "y": 0.0, "yaw": 0.0, "pitch": 0.0, "roll": 0.0})
    found = find_mount(CameraFile(intrinsics=TRUE, mount=by_hand), WALL, *drive(0.35, gain, late_s, step_rad))
    for name in ("x", "y", "yaw", "pitch", "roll"):
        error = abs(getattr(found.mount, name) - getattr(MOUNT, name))
        assert error < max(3.0 * found.deviations[name], 0.002), name
    assert max(found.deviations["x"], found.deviations["yaw"]) < 0.02
    assert abs(found.late_s - late_s) < max(3.0 * found.deviations["late_s"], 0.002) < 0.02
    after = found.applied(CameraFile(intrinsics=TRUE, mount=by_hand, delay_s=-0.1))
    assert (after.mount, after.delay_s) == (found.mount, pytest.approx(late_s - 0.1, abs=0.005))


def test_mount_is_refused_after_a_drive_without_a_turn():
    with pytest.raises(UsageError, match="turns by"):
        find_mount(CameraFile(intrinsics=TRUE, mount=MOUNT), WALL, *drive(0.05))


def test_printed_tags_are_true_to_size(monkeypatch):
    drawn = []
    monkeypatch.setattr(
        "matplotlib.backends.backend_pdf.PdfPages.savefig", lambda self, figure: drawn.append(figure)
    )
    tag_pages([5, 17], 0.14, "a4")
    board_page("letter")
    edges = []
    for figure in drawn:
        for found in Detector().detect(grey(figure, 150)):
            edges += [(found.id, math.dist(found.corners[0], found.corners[1]) / 150 * 0.0254)]
    assert [edge for edge in edges if edge[0] in (5, 17) and edge[1] > 0.1] == [
        (5, pytest.approx(0.14, abs=3e-4)),
        (17, pytest.approx(0.14, abs=3e-4)),
    ]
    on_board = [edge for _, edge in edges if edge < 0.1]
    assert len(on_board) == len(BOARD)
    assert np.mean(on_board) == pytest.approx(BOARD_TAG_M, abs=2e-4)


def grey(figure: Figure, dpi: int):
    """Draw a figure on grey levels."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[:, :, 0])


def test_tag_too_large_for_the_page_is_refused():
    with pytest.raises(UsageError, match=r"--size 0\.3"):
        tag_pages([0], 0.3, "a4")


CAMERA_INFO = """\
image_width: 640
image_height: 480
camera_name: cam
camera_matrix: {rows: 3, cols: 3, data: [500.5, 0, 320, 0, 501, 241, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.001, 0.002, 0.0]}
"""


def test_intrinsics_of_ros_are_read(tmp_path):
    file = tmp_path / "info.yaml"
    file.write_text(CAMERA_INFO)
    found = load_camera_info(file)
    assert (found.fx, found.fy, found.cx, found.cy) == (500.5, 501.0, 320.0, 241.0)
    assert found.distortion == (0.1, -0.2, 0.001, 0.002, 0.0)
    for wrong in ("image_width: 640\n", "image_width: 640\ncamera_matrix: 3\n"):
        file.write_text(wrong)
        with pytest.raises(ConfigError, match="camera_info"):
            load_camera_info(file)


def test_camera_whose_mount_nobody_measured_gives_no_poses(tmp_path, capsys):
    for name, text in (("info", CAMERA_INFO), ("tags", dump_yaml(WALL.model_dump(mode="json")))):
        (tmp_path / f"{name}.yaml").write_text(text)
    file, tags = str(tmp_path / "camera.yaml"), str(tmp_path / "tags.yaml")
    source = ["--camera", str(tmp_path), "--camera-file", file]
    assert cli.run(["tag", "calibrate", *source, "--camera-info", str(tmp_path / "info.yaml")]) == 0
    assert "its mount is all zero" in capsys.readouterr().out
    for command in (["run"], ["calibrate", "--robot", "tcp/127.0.0.1"]):
        assert cli.run(["tag", *command, *source, "--map", tags]) == 2
        assert f"{file}: mount: all zero" in capsys.readouterr().err
