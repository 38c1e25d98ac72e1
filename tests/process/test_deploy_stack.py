"""The driver among real processes: mock Pioneer and bridge over loopback TCP and Zenoh."""

import signal
import time
from itertools import pairwise

import numpy as np
import pytest

from deploy.drive_records import TICKS_TOPIC, TickRecord
from deploy.replay import replay
from rover_ncp.core.geometry import Pose, distance, wrap_angle
from rover_ncp.core.messages import read_text
from rover_ncp.core.protocol import parse_json
from rover_ncp.core.recording import read_recording
from sim.live.live_run import LiveRun
from sim.live.processes import wait_for

BRAKING_S = 0.16 / 0.31 + 0.15
"""From the circuit's full speed, with the base's delay."""
SLOW_MACHINE_S = 0.6


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A rover for all drives of this file. The last drive ends its bridge."""
    with LiveRun(tmp_path_factory.mktemp("rig") / "log") as run:
        yield run


@pytest.fixture
def deploy(run, request, tmp_path):
    """Starts a driver that goes straight ahead, far beyond this short course's goal."""
    data = request.config.rootpath / "tests" / "data"
    files = ["--policy", str(data / "golden/parking.bnn"), "--course", str(data / "short_course.yaml")]
    return lambda: run.deploy(*files, "--record", str(tmp_path / "run.mcap"), "--overwrite")


def where(run):
    states = run.truth.read()
    return states[-1].pose if states else Pose(0.0, 0.0, 0.0)


def driving(run, deploy):
    """Start a driver and wait until the rover is well on its way."""
    start, driver = where(run), deploy()
    wait_for(lambda: distance(where(run), start) > 0.1 or not driver.running, 30.0)
    return driver


def standstill_s(run, since_ns):
    """Wait until the true rover has stood for 0.4 s; return how long after ``since_ns`` it stopped."""

    def stands():
        states = run.truth.read()[-40:]
        return distance(states[0].pose, states[-1].pose) < 1e-4

    wait_for(stands)
    states = [state for state in run.truth.read() if state.wall_ns > since_ns]
    moving = [b.wall_ns for a, b in pairwise(states) if distance(a.pose, b.pose) > 1e-6]
    return (moving[-1] - since_ns) * 1e-9 if moving else 0.0


def test_the_estimate_is_where_the_rover_is_and_the_drive_recomputes(run, deploy, tmp_path):
    done = deploy().wait(60)
    assert done.code == 1, done
    assert "from the goal" in done.result["reason"]
    assert done.result["ticks"] + done.result["missed"] == 40
    assert done.result["stopped_by"] is None

    truth = run.truth.read()
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


@pytest.mark.long
def test_however_a_drive_ends_the_rover_stands(run, deploy, tmp_path):
    """Interrupted, killed, without a bridge: three drivers, one after the other, on one rover."""
    recording_path = tmp_path / "run.mcap"

    driver = driving(run, deploy)
    pressed_ns = time.time_ns()
    driver.send_signal(signal.SIGINT)
    done = driver.wait(20)
    assert done.code == 130
    assert done.result["reason"] == "interrupted"
    assert standstill_s(run, pressed_ns) < 0.5 + BRAKING_S + SLOW_MACHINE_S
    assert read_recording(recording_path).complete

    driver = driving(run, deploy)
    driver.send_signal(signal.SIGKILL)
    killed_ns = time.time_ns()
    assert driver.wait(10).code == -signal.SIGKILL
    assert standstill_s(run, killed_ns) < 0.5 + BRAKING_S + SLOW_MACHINE_S
    recording = read_recording(recording_path)
    assert not recording.complete
    assert killed_ns - recording.messages[-1].log_ns < 0.5e9 + SLOW_MACHINE_S * 1e9
    comparison = replay(recording_path)
    assert comparison.difference is None
    assert comparison.ticks > 5

    driver = driving(run, deploy)
    run.bridge.send_signal(signal.SIGKILL)
    killed_ns = time.time_ns()
    done = driver.wait(20)
    assert time.time_ns() - killed_ns < 5e9
    assert done.code == 4
    assert done.result["stopped_by"] == "bridge-lost"
    assert done.last_line == "stopped by bridge-lost: the bridge is gone"
    assert standstill_s(run, killed_ns) < 2.0 + BRAKING_S + SLOW_MACHINE_S  # the base's own watchdog
