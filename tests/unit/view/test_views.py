"""Topics in a recording for viewers."""

from types import SimpleNamespace

import numpy as np
import pytest

from deploy.drive.controller import Tick
from deploy.drive.measurements import SampleRef
from deploy.drive.records import START_TOPIC, TICKS_TOPIC, StartRecord, TickRecord, numbers
from deploy.drive.tick_messages import Publisher
from deploy.estimator.estimator import Estimate
from rover_ncp.core.geometry import STANDSTILL, Pose, compose
from rover_ncp.wire.cdr import decode

NAMES = ("A", "B", "Long_name")


def recorded(ticks=3):
    """The messages for viewers of a drive."""
    messages = []
    link, clock = SimpleNamespace(publish=lambda *_: None), SimpleNamespace(time_ns=lambda: 1_000)
    publisher = Publisher(link, messages.append, NAMES, clock)
    start = StartRecord(sample=SampleRef(0, 0, 0), pose=(0.5, 0.0, 0.1))
    publisher.start(start, Pose(3.0, -2.0, 1.0))
    for k in range(ticks):
        estimate = Estimate(0.0, Pose(0.1 * k, 0.2, 0.3), STANDSTILL, np.eye(5), 1.0, 0.0)
        record = {"index": k, "now_ns": 0, "wall_ns": 2_000 + k, "samples": (), "predicted": False}
        record |= {"estimate": numbers(estimate), "command": None, "sequence": None}
        tick = Tick(k, 0.0, estimate, STANDSTILL, np.array([-70.0 - k, -1e-9, -12.25]))
        publisher.tick(TickRecord(**record), estimate, None if k == ticks - 1 else tick)
    publisher.finish()
    return [message for message in messages if message.topic not in {START_TOPIC, TICKS_TOPIC}]


def test_transform_places_odometry_on_the_course():
    frames = next(message for message in recorded() if message.topic == "deploy/frames")
    transform = decode(frames.type, frames.data).transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("course", "odom")
    where, turn = transform.transform.translation, transform.transform.rotation
    odom = Pose(where.x, where.y, 2 * np.arctan2(turn.z, turn.w))
    assert compose(odom, Pose(3.0, -2.0, 1.0)) == pytest.approx(Pose(0.5, 0.0, 0.1))


def test_the_path_is_whole_and_there_from_the_start():
    messages = recorded()
    path = messages[-1]
    assert (path.topic, path.log_ns) == ("deploy/path", 1_000)
    poses = decode(path.type, path.data).poses
    assert [pose.pose.position.x for pose in poses] == pytest.approx([0.0, 0.1, 0.2])
    assert [m.topic for m in messages].count("deploy/pose") == 3
    assert [message.topic for message in recorded(ticks=0)] == ["deploy/frames"]
