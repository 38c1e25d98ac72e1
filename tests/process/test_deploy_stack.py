"""The driver among real processes: mock Pioneer and bridge over loopback TCP and Zenoh."""

import numpy as np
from kit.paths import DATA

from deploy.drive.records import TICKS_TOPIC, TickRecord
from deploy.replay import replay
from rover_ncp.core.geometry import wrap_angle
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import parse_json
from sim.live.live_run import LiveRun


def test_the_estimate_is_where_the_rover_is_and_the_drive_recomputes(tmp_path):
    # It goes straight ahead, far beyond this short course's goal.
    files = ["--policy", str(DATA / "golden/parking.bnn"), "--course", str(DATA / "short_course.yaml")]
    with LiveRun(tmp_path / "log") as run:
        done = run.deploy(*files, "--record", str(tmp_path / "run.mcap")).wait(60)
        truth = run.truth.read()
    assert done.code == 1, done
    assert "from the goal" in done.result["reason"]
    assert done.result["ticks"] + done.result["missed"] == 40
    assert done.result["stopped_by"] is None

    t = np.array([state.wall_ns for state in truth])
    poses = np.unwrap(np.array([state.pose for state in truth]), axis=0)
    recording = read_recording(tmp_path / "run.mcap")
    records = [parse_json(TickRecord, read_text(message.data)) for message in recording.topic(TICKS_TOPIC)]
    assert len(records) == done.result["ticks"] + 1
    assert poses[-1][0] > 0.3
    errors = []
    for record in records:
        if not record.predicted:
            x, y, theta = (np.interp(record.wall_ns, t, column) for column in poses.T)
            errors.append(np.hypot(record.estimate[0] - x, record.estimate[1] - y))
            assert abs(wrap_angle(record.estimate[2] - theta)) < 0.004
    # Full speed is 1.6 mm in 10 ms: what a stalled machine adds to the age of a few samples is allowed.
    assert np.median(errors) < 0.002
    assert max(errors) < 0.015

    assert replay(tmp_path / "run.mcap").difference is None
