"""Calibrations as other programs write them."""

import cv2
import numpy as np
import pytest

from deploy.tag.cameras.camera_info import load_camera_info
from deploy.tag.locate import undistorted
from deploy.tag.tag_map import Intrinsics
from rover_ncp.core.errors import ConfigError

K, D = "[500.5, 0, 320, 0, 501, 241, 0, 0, 1]", (0.1, -0.2, 0.001, 0.002, 0.03)
SIZE = "image_width: 640\nimage_height: 480\n"


def ros(d, more, k=K):
    matrix = f"camera_matrix: {{rows: 3, cols: 3, data: {k}}}\n"
    return f"{SIZE}{matrix}{more}distortion_coefficients: {{rows: 1, cols: {len(d)}, data: {list(d)}}}\n"


OPENCV = f"""%YAML:1.0
---
calibration_time: "Sat Nov 28"
flags: {{ fixed: 1 }}
{SIZE}camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {K}
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {list(D)}
"""
ECHO = f"height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd: {list(D)}\nk: {K}\nr: [1]\n---\n"
RATIONAL = (*D, 0.4, 0.1, 0.02, *[0.0] * 6)


@pytest.mark.parametrize(
    ("text", "model", "distortion"),
    [
        pytest.param(ros(D, "distortion_model: plumb_bob\n"), "pinhole", D, id="camera_calibration"),
        pytest.param(ros(RATIONAL, "distortion_model: rational_polynomial\n"), "pinhole", RATIONAL, id="14"),
        pytest.param(ros(D[:4], "distortion_model: equidistant\n"), "fisheye", D[:4], id="equidistant"),
        pytest.param(ECHO, "pinhole", D, id="topic echo"),
        pytest.param(OPENCV, "pinhole", D, id="OpenCV's YAML"),
    ],
)
def test_calibration_of_each_format_is_read(tmp_path, text, model, distortion):
    file = tmp_path / "info.yaml"
    file.write_text(text)
    found = load_camera_info(file)
    read = (found.width, found.height, found.fx, found.fy, found.cx, found.cy)
    assert read == (640, 480, 500.5, 501, 320, 241)
    assert (found.model, found.distortion) == (model, pytest.approx(distortion))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ros(D[:4], ""), "4 coefficients without distortion_model: add it"),
        (ros(D, "distortion_model: equidistant\n"), "5 coefficients of a fisheye camera, expected 4"),
        (ros(D, "", K.replace("501", "1")), "focal lengths 500.5 and 1 do not fit"),
        (ros(D, "", "[500, 0, 320, 0, 500, 241, 0, 0, 0]"), "expected fx, 0, cx, 0, fy, cy, 0, 0, 1"),
        (
            "image_width: 640\n",
            "no image_height, camera_matrix, distortion_coefficients; expected a calibration",
        ),
        ("# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n640\n", "expected a calibration of ROS"),
    ],
)
def test_calibration_that_cannot_be_right_is_refused(tmp_path, text, words):
    file = tmp_path / "info.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_camera_info(file)


def test_points_of_a_fisheye_are_where_opencv_projects_them():
    fisheye = Intrinsics(
        width=640, height=480, fx=300, fy=300, cx=320, cy=240, model="fisheye", distortion=D[:4]
    )
    flat = np.array([[0.0, 0.0], [0.5, -0.3], [-1.2, 0.8]])
    rays = cv2.convertPointsToHomogeneous(flat)
    pixels, _ = cv2.fisheye.projectPoints(rays, np.zeros(3), np.zeros(3), fisheye.matrix, np.array(D[:4]))
    assert undistorted(fisheye, pixels[:, 0, :]) == pytest.approx(flat, abs=1e-6)
