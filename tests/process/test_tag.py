"""Tags as real processes: a mock renders them, `tag run` sends poses, `deploy` starts from one."""

import math
import signal

import cv2
import pytest
from kit.tags import picture_of

from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap
from deploy.view.server import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.geometry import Pose
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.key_table import TAG_OUTLINES, TAG_VIEW, spec
from sim.park.live import LiveRun, Process, wait_for

CAMERA = CameraFile(
    intrinsics=Intrinsics(width=640, height=480, fx=400.0, fy=400.0, cx=319.5, cy=239.5),
    mount=Mount(x=0.1, y=0.0, z=0.3),
)
TAGS = TagMap(
    frame="course",
    tags=tuple(Tag(id=tag, size=0.14, x=1.2, y=y, z=0.3, yaw=math.pi) for tag, y in ((0, 0.2), (1, -0.2))),
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tags")
    for name, model in (("camera.yaml", CAMERA), ("tags.yaml", TAGS)):
        (folder / name).write_text(dump_yaml(model.model_dump(mode="json")))
    return ["--camera-file", str(folder / "camera.yaml")], ["--map", str(folder / "tags.yaml")]


def taken_at(message):
    """Return the stamp of a picture, or of the outlines in it."""
    return message.points[0].timestamp if hasattr(message, "points") else message.header.stamp


def test_drive_starts_from_the_pose_of_tags_and_camera_that_dies_ends_the_localiser(
    tmp_path, files, run_json
):
    (_, camera), (_, tags) = files
    mock = ["--camera", camera, "--tags", tags, "--camera-listen", "127.0.0.1:0"]
    with LiveRun(tmp_path, mock=mock) as live:
        address = live.mock.wait_for_line("camera at ")
        picture = tmp_path / "view.jpg"
        arguments = ["run", "--camera", address, *files[0], *files[1], "--robot", live.robot]
        run = live.start_process(
            lambda: Process("tag", [*arguments, "--picture", str(picture), "--json"], tmp_path)
        )
        views = []
        watching = Viewer(BridgeAddress(live.robot), lambda message: views.append(message.topic))
        recording = tmp_path / "run.mcap"
        drive = f"deploy --robot {live.robot} --pose required --dry-run --duration 2 --record {recording}"
        _, result = run_json(drive)
        assert result["pose"]["placed"]
        taken = read_recording(recording)
        for name in (TAG_VIEW, TAG_OUTLINES):
            # When the pictures were taken: on a busy computer they arrive later, one more than another.
            stamps = [taken_at(decode(spec(name).type, message.data)) for message in taken.topic(name)]
            times_s = [stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]
            assert len(times_s) - 1 == pytest.approx(2.0 * (times_s[-1] - times_s[0]), abs=1.5)
            assert len(times_s) >= 3
        assert len(decode(spec(TAG_OUTLINES).type, taken.topic(TAG_OUTLINES)[-1].data).points) == len(
            TAGS.tags
        )
        with watching:
            assert wait_for(picture.exists)
            assert wait_for(lambda: {TAG_VIEW, "rover/localiser"} <= set(views))
        live.mock.send_signal(signal.SIGTERM)
        lost = run.wait(20.0)
    assert lost.code == 2
    assert lost.result["error"].startswith(f"camera {address}: ")


def test_localiser_of_a_folder_needs_no_robot_and_reports(tmp_path, files, run_json):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for index in range(3):
        pose = Pose(0.1 * index, 0.02, 0.05)
        cv2.imwrite(str(pictures / f"{index}.png"), picture_of(pose, CAMERA, TAGS, seed=index))
    options = " ".join([*files[0], *files[1]])
    code, result = run_json(f"tag run --camera {pictures} {options}")
    assert (code, result["pictures"], result["poses"]) == (0, 3, 3)
    assert result["last"]["x"] == pytest.approx(0.2, abs=0.005)
