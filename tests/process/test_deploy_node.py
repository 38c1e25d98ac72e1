"""The driving process over real Zenoh on loopback TCP: what the virtual clock cannot show."""

import contextlib
import os
import signal

import pytest

from deploy import teleop
from deploy.identify.run import identify_robot
from deploy.recorder import Recorder
from deploy.replay import replay
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.console import Output
from rover_ncp.core.errors import NoBridge, SafetyStop
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_rover_first(bridge, drive, tmp_path, number):
    before = signal.getsignal(number)
    bridge.after_commands(3, lambda: os.kill(os.getpid(), number))
    code, result = drive()
    assert (code, result["reason"]) == (130, "interrupted")
    assert 2 <= result["ticks"] < 15
    wait_for(lambda: bridge.commands[-1][1] == STANDSTILL)  # it may arrive after the release
    assert bridge.released.is_set()
    assert read_recording(tmp_path / "run.mcap").complete
    assert signal.getsignal(number) is before


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


class Keys(contextlib.nullcontext):
    """A terminal at which nothing is typed."""

    def discard(self):
        raise AssertionError("keys are read after the motors were refused")


@pytest.mark.parametrize("command", ["teleop", "identify"])
def test_a_refused_request_for_the_motors_leaves_no_recording(bridge, tmp_path, monkeypatch, command):
    bridge.refusal = "stop-button"
    address, path, output = BridgeAddress(bridge.robot), tmp_path / "run.mcap", Output(as_json=True)
    for _ in range(2):  # the second attempt finds no file of the first
        if command == "teleop":
            monkeypatch.setattr(teleop, "Terminal", lambda: Keys(Keys()))
            assert teleop.run(address, Recorder(path), output) == 4
        else:
            with pytest.raises(SafetyStop, match="refuses the motors: it is pressed"):
                identify_robot(address, Recorder(path), 0.8, tmp_path / "rover.yaml", output)
        assert [*tmp_path.iterdir()] == []
    assert bridge.commands == []


def test_a_router_without_a_bridge_in_our_namespace_is_no_bridge(drive):
    with pytest.raises(NoBridge, match="no bridge is announced there in namespace bot7"):
        drive(namespace="bot7")
