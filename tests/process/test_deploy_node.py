"""The driving process over real Zenoh on loopback TCP: what the virtual clock cannot show."""

import os
import signal

from deploy.replay import replay
from rover_ncp.core.geometry import STANDSTILL, Pose, distance
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.messages import read_pose
from sim.park.live import wait_for


def test_a_drive_from_start_to_end(bridge, drive, tmp_path):
    code, result = drive()
    assert (code, result["state"], result["verdict"]) == (1, "ended", "not parked")
    assert result["ticks"] <= 20 <= result["ticks"] + result["overruns"]

    # One driver, rising numbers, the last command is zero, and then the lease is released.
    wait_for(lambda: bridge.commands[-1][1] == STANDSTILL)  # it may arrive after the release
    tags = [tag for tag, _ in bridge.commands]
    assert [request.enable for request in bridge.requests] == [True, False]
    assert {tag.lease for tag in tags} == {1}
    assert [tag.sequence for tag in tags] == list(range(len(tags)))
    assert max(velocity.v for _, velocity in bridge.commands) > 0.1

    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert set(recording.attachments) == {"policy.yaml", "course.yaml", "deploy.yaml"}
    estimates = [read_pose(message.data) for message in recording.topic("rover/estimate")]
    assert {estimate.frame for estimate in estimates} == {"course"}
    assert distance(estimates[0].pose, Pose(0, 0, 0)) < 1e-6
    assert estimates[-1].pose.x > 0.05
    assert bridge.rover.pose.x - estimates[-1].pose.x < 0.05  # it braked after the last tick
    assert len(recording.topic("rover/neurons")) == result["ticks"]
    assert len(recording.topic("cmd_vel")) == len(bridge.commands)
    assert {"odom", "rover/gate", "rover/status"} <= {message.topic for message in recording.messages}

    comparison = replay(tmp_path / "run.mcap")
    assert comparison.difference is None
    assert comparison.complete
    assert comparison.ticks == result["ticks"]


def test_a_signal_stops_the_rover_first(bridge, drive, tmp_path):
    bridge.after_commands(3, lambda: os.kill(os.getpid(), signal.SIGTERM))
    code, result = drive()
    assert (code, result["reason"]) == (130, "interrupted")
    assert 2 <= result["ticks"] < 15
    wait_for(lambda: bridge.commands[-1][1] == STANDSTILL)  # it may arrive after the release
    assert bridge.released.is_set()
    assert read_recording(tmp_path / "run.mcap").complete


def test_a_bridge_whose_token_is_gone_ends_the_drive(bridge, drive):
    bridge.after_commands(3, bridge.vanish)
    code, result = drive()
    assert (code, result["stopped_by"]) == (4, "bridge-lost")
    assert result["ticks"] < 15
    assert bridge.released.is_set()


def test_a_drive_that_is_refused_leaves_no_recording(bridge, drive, tmp_path):
    bridge.refusal = "stop-button"
    code, result = drive()
    assert (code, result["stopped_by"], result["recording"]) == (4, "stop-button", None)
    assert "refuses the motors: it is pressed" in result["reason"]
    assert not (tmp_path / "run.mcap").exists()
    assert bridge.commands == []
