"""Streams of cameras as bytes, their stamps, and the devices of a machine."""

import time
from collections import Counter

import cv2
import numpy as np
import pytest

from deploy.tag.cameras.camera import DeviceCamera, DeviceSettings, PictureMoments, devices
from deploy.tag.cameras.http_camera import MAX_PICTURE, PictureReader, _stamp_ns

PICTURES = [cv2.imencode(".jpg", np.full((8, 8), level, np.uint8))[1].tobytes() for level in (10, 90, 200)]
NS_PER_S = 1_000_000_000


def stream(parts=PICTURES, *, line="--frame", head="Content-Type: image/jpeg\r\n", length=True, after="\r\n"):
    """Return a stream; ``line`` begins each part."""
    for data in parts:
        lengths = f"Content-Length: {len(data)}\r\n" if length else ""
        yield f"{line}\r\n{head}{lengths}\r\n".encode() + data + after.encode()


def pictures(chunks):
    """Return the data of the pictures, and the reasons for those that are left out."""
    reader = PictureReader()
    found = [each for chunk in chunks for each in reader.feed(chunk)]
    return [each.data for each in found if not isinstance(each, str)], [
        each for each in found if isinstance(each, str)
    ]


@pytest.mark.parametrize("size", [7, 1 << 20])
@pytest.mark.parametrize(
    "form",
    [
        {},
        {"length": False},
        {"line": "\r\n--frame", "after": ""},
        {"line": "a multipart message: nothing here\n", "head": "\n", "after": "\n"},
    ],
)
def test_stream_of_each_dialect_gives_its_pictures(form, size):
    data = b"".join(stream(**form))
    assert pictures(data[at : at + size] for at in range(0, len(data), size)) == (PICTURES, [])


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (PICTURES[0][:-40], "damaged"),
        (PICTURES[0][:-2] + b"\x00" * 2 * MAX_PICTURE, "picture of more than 8 MiB"),
    ],
)
def test_picture_without_an_end_costs_no_other_and_is_held_in_bounds(bad, words):
    reader, found, held = PictureReader(), [], 0
    data = b"".join(stream([PICTURES[0], bad, *PICTURES]))
    for at in range(0, len(data), 1 << 16):
        found += list(reader.feed(data[at : at + (1 << 16)]))
        held = max(held, len(reader._buffer))
    assert [words in each for each in found if isinstance(each, str)] == [True]
    assert [each.data for each in found if not isinstance(each, str)] == [PICTURES[0], *PICTURES]
    assert held <= MAX_PICTURE + (1 << 17)


def moments(stamps, period_s=0.1, transit_s=(0.0,) * 60):
    """Return ages in s of pictures that are sent every ``period_s`` and arrive ``transit_s`` later."""
    clock, found = PictureMoments(), []
    for k, (stamp, late_s) in enumerate(zip(stamps, transit_s, strict=False)):
        arrival_ns = round((1000.0 + k * period_s + late_s) * NS_PER_S)
        moment_ns = clock.wall_ns(_stamp_ns(stamp), arrival_ns, -7)
        found.append(None if moment_ns is None else round((arrival_ns - moment_ns) / NS_PER_S, 6))
    return found


@pytest.mark.parametrize("began_s", [0.5, 1_732_000_000.0, 1_732_003_600.0])
def test_stamps_of_any_clock_tell_how_late_a_picture_is(began_s):
    """Since the camera's start (ESP32), of this machine's clock, and of one an hour ahead."""
    transit_s = [0.01, 0.05, 0.01, 0.3, 0.02]
    ages = moments([f"{began_s + 0.1 * k:.6f}" for k in range(5)], transit_s=transit_s)
    assert ages == pytest.approx([0.0, 0.04, 0.0, 0.29, 0.01], abs=1e-5)


@pytest.mark.parametrize("stamp", [None, "2026-11-27T23:00:00Z", "nan", "1e300"])
def test_picture_without_a_usable_stamp_counts_from_its_arrival(stamp):
    assert moments([stamp] * 3) == [0.0] * 3


@pytest.mark.parametrize(
    "stamps",
    [
        ["5.0"] * 60,
        [str(1_732_000_000 + k // 10) for k in range(60)],
        [str(5000 + 100 * k) for k in range(60)],
    ],
    ids=["constant", "whole seconds", "milliseconds"],
)
def test_stamps_that_are_no_clock_are_given_up(stamps):
    found = moments(stamps)
    assert found[-40:] == [0.0] * 40
    assert found.count(None) < 10


def test_clock_that_is_set_costs_a_picture():
    """As that of a camera that begins at 0 and gets the time from the network."""
    for set_to_s in (1_732_000_000, -3600):
        found = moments([str(10_000.5 + 0.1 * k + (set_to_s if k >= 10 else 0)) for k in range(20)])
        assert found.count(None) == 1
        assert [each for each in found if each is not None] == pytest.approx([0.0] * 19, abs=1e-5)


def test_each_camera_is_listed_once_in_order_with_the_path_that_it_keeps(tmp_path):
    for number, name, index in ((10, "Webcam", 0), (2, "RealSense", 0), (3, "RealSense", 1)):
        node = tmp_path / f"sys/class/video4linux/video{number}"
        node.mkdir(parents=True)
        (node / "name").write_text(f"{name}\n")
        (node / "index").write_text(f"{index}\n")
    (tmp_path / "dev/v4l/by-id").mkdir(parents=True)
    (tmp_path / "dev/v4l/by-id/usb-Webcam-index0").symlink_to("../../video10")
    assert [(each.path, each.name, each.stable) for each in devices(tmp_path)] == [
        ("/dev/video2", "RealSense", ""),
        ("/dev/video10", "Webcam", "/dev/v4l/by-id/usb-Webcam-index0"),
    ]


class Device:
    """A device with an autofocus, which has the size that is asked for."""

    def __init__(self, *opened):
        self.opened, self.was_set = opened, {cv2.CAP_PROP_AUTOFOCUS: 1.0}
        Device.last = self

    def isOpened(self):  # noqa: N802, OpenCV's name
        return True

    def set(self, key, value):
        self.was_set[key] = value
        return True

    def get(self, key):
        return self.was_set.get(key, 0.0)

    def read(self):
        time.sleep(0.01)
        size = (self.was_set[key] for key in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH))
        return True, np.zeros((*size, 3), np.uint8)

    def release(self):
        pass


@pytest.mark.parametrize("focus", [None, 30.0])
def test_device_is_set_to_its_calibration(monkeypatch, caplog, focus):
    monkeypatch.setattr(cv2, "VideoCapture", Device)
    with DeviceCamera("/dev/video7", DeviceSettings((1280, 720), 30.0, focus), Counter()) as camera:
        assert next(iter(camera)).grey.shape == (720, 1280)
    assert (Device.last.opened[0], Device.last.was_set[cv2.CAP_PROP_FPS]) == (7, 30.0)
    assert ("its autofocus is on" in caplog.text) is (focus is None)
    assert Device.last.get(cv2.CAP_PROP_AUTOFOCUS) == (focus is None)
