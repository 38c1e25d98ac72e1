"""The pictures of a localiser that a page and a recording get."""

import cv2
import numpy as np
import pytest
from kit.bridge_bench import wait_for
from kit.tags import CAMERA, WALL, picture_of

from deploy.tag.detector import Detector
from deploy.tag.view import SENT_WIDTH, View
from deploy.tag.view_file import ViewFile
from deploy.view.timeline import read_jpeg
from rover_ncp.core.geometry import Pose
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.key_table import TAG_OUTLINES, TAG_VIEW, spec


def test_outlines_lie_on_the_tags_of_the_smaller_picture():
    grey = cv2.resize(picture_of(Pose(0.9, 0.05, 0.1), CAMERA, WALL), (1280, 960))
    tags = Detector().detect(grey)
    sent = View(grey, tags, "x 0.9 m θ 0.1 rad", 5_000_000_000).messages()
    picture = cv2.imdecode(np.frombuffer(read_jpeg(sent[TAG_VIEW]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture.shape[1] == SENT_WIDTH
    outlines = decode(spec(TAG_OUTLINES).type, sent[TAG_OUTLINES])
    assert [each.text for each in outlines.texts] == ["7", "8", "9"]
    for outline, tag in zip(outlines.points, tags, strict=True):
        corners = [(point.x, point.y) for point in outline.points]
        assert np.array(corners) == pytest.approx((tag.corners + 0.5) / 2.0, abs=1e-6)
    assert decode(spec(TAG_VIEW).type, sent[TAG_VIEW]).header.stamp.sec == 5


def test_a_picture_that_cannot_be_written_is_named_once_and_written_again_later(tmp_path):
    folder, said = tmp_path / "run", []
    view = View(np.zeros((48, 64), np.uint8), (), "", 0)
    folder.write_text("no folder")  # no file can be made in it
    with ViewFile(folder / "view.jpg", said.append) as file:
        for _ in range(2):
            file.show(view)
            assert wait_for(lambda: file._views.empty() and said, 5.0, "the attempt")
        folder.unlink()
        assert wait_for(lambda: file.show(view) or (folder / "view.jpg").exists(), 5.0, "the picture")
    assert len(said) == 1
    assert "view.jpg" in said[0]
    assert cv2.imread(str(folder / "view.jpg")).shape == (48, 64, 3)
