"""The whole driving process against a bridge that can be made to fail: real Zenoh over loopback TCP."""

import collections
import math
import os
import signal
import threading
import time

import pytest
from kit.deploy_bench import LEASE, ODOM_AT_START, STILL

from deploy.replay import replay
from rover_ncp.core.errors import AnotherDriver, NoBridge, NoRobot
from rover_ncp.core.geometry import Pose, Velocity, compose, distance
from rover_ncp.recording.recording import read_recording
from rover_ncp.wire.messages import odometry, read_pose
from rover_ncp.wire.protocol import GateStatus


@pytest.fixture
def golden(request):
    """A circuit that drives straight ahead at full speed."""
    return request.config.rootpath / "tests/data/golden/parking.bnn"


def test_a_drive_from_start_to_end(bridge, drive, tmp_path):
    code, result = drive()
    assert code == 1
    assert result["state"] == "ended"
    assert "from the goal" in result["reason"]
    assert not result["parked"]
    assert result["ticks"] + result["missed"] == 20
    assert result["estimate_error_m"] > 6

    # One driver, rising numbers, the last word is zero, and then the motors are given back.
    tags = [tag for tag, _ in bridge.commands]
    assert [request.enable for request in bridge.requests] == [True, False]
    assert {tag.lease for tag in tags} == {LEASE}
    assert [tag.sequence for tag in tags] == list(range(len(tags)))
    assert bridge.commands[-1][1] == STILL
    assert max(velocity.v for _, velocity in bridge.commands) > 0.01

    # The circuit saw the course's frame: the estimate starts at the origin, wherever odometry stands.
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert set(recording.attachments) == {"policy.yaml", "course.yaml", "deploy.yaml"}
    estimates = [read_pose(message.data) for message in recording.topic("rover/estimate")]
    assert {estimate.frame for estimate in estimates} == {"course"}
    assert distance(estimates[0].pose, Pose(0, 0, 0)) < 1e-6
    there = compose(ODOM_AT_START, estimates[-1].pose)
    assert distance(there, bridge.pose) < 0.005
    assert distance(ODOM_AT_START, bridge.pose) > 0.05
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
    bridge.after_commands(6, lambda: os.kill(os.getpid(), number))
    code, result = drive()
    assert code == 130
    assert result["reason"] == "interrupted"
    assert 5 <= result["ticks"] < 15
    assert bridge.commands[-1][1] == STILL
    assert bridge.released.is_set()
    assert read_recording(tmp_path / "run.mcap").complete
    assert signal.getsignal(number) is before


def seen_once_driving(bridge, corrupt):
    """Give odometry as it is until the driver drives, then what ``corrupt`` makes of it."""

    def odom(pose, velocity, stamp):
        return odometry(pose, velocity, stamp) if len(bridge.commands) < 4 else corrupt(pose, velocity, stamp)

    return odom


def late(by_s):
    """Give odometry as a link that became slow does: in order, later than it was measured."""
    held = collections.deque()

    def corrupt(pose, velocity, stamp):
        held.append((time.monotonic(), odometry(pose, velocity, stamp)))
        return held.popleft()[1] if time.monotonic() - held[0][0] >= by_s else None

    return corrupt


BAD_ODOMETRY = {
    "silent": ({"odometry-age"}, lambda pose, velocity, stamp: None),
    "garbled": ({"odometry-age"}, lambda pose, velocity, stamp: b"\x00\x01\x00\x00nonsense"),
    "late": ({"odometry-age"}, late(0.5)),
    "nan": ({"estimator"}, lambda pose, velocity, stamp: odometry(pose, Velocity(math.nan, 0), stamp)),
    "nowhere": ({"estimator"}, lambda pose, v, stamp: odometry(Pose(math.inf, 0, 0), v, stamp)),
    "kidnapped": ({"estimator"}, lambda pose, v, stamp: odometry(Pose(pose.x + 0.5, *pose[1:]), v, stamp)),
}


@pytest.mark.parametrize("name", BAD_ODOMETRY)
def test_bad_odometry_stops_the_rover_within_half_a_second(bridge, drive, name):
    rules, corrupt = BAD_ODOMETRY[name]
    when = []

    def noted(*sample):
        when.append(time.monotonic())
        return corrupt(*sample)

    bridge.odom = seen_once_driving(bridge, noted)
    bridge.released.clear()
    ended = []
    waiting = threading.Thread(
        target=lambda: (bridge.released.wait(20), ended.append(time.monotonic())), daemon=True
    )
    waiting.start()
    code, result = drive()
    waiting.join(20)
    assert (code, result["state"]) == (4, "fault")
    assert result["stopped_by"] in rules
    assert result["stopped_by"] in result["reason"]
    assert bridge.commands[-1][1] == STILL
    # 0.4 s of age, less the one period that had passed since the last good sample, and a slow machine.
    assert ended[0] - when[0] < 0.5


def test_a_lost_sample_is_bridged_by_prediction_and_counted(bridge, drive, tmp_path):
    lost = iter([True])
    bridge.odom = seen_once_driving(bridge, lambda *sample: None if next(lost, False) else odometry(*sample))
    code, result = drive()
    assert code == 1
    assert result["predicted"] >= 1
    assert result["overruns"] == result["predicted"] + result["missed"]
    assert result["ticks"] + result["missed"] == 20
    assert replay(tmp_path / "run.mcap").difference is None


@pytest.mark.parametrize(
    ("harm", "rule"),
    [
        (lambda bridge: bridge.vanish(), "bridge-lost"),
        (lambda bridge: setattr(bridge, "gate", GateStatus(ended="bumper")), "bumper"),
        (lambda bridge: setattr(bridge, "gate", GateStatus(lease=LEASE + 1)), "lease"),
    ],
)
def test_losing_the_bridge_or_the_lease_ends_the_drive_with_a_name(bridge, drive, harm, rule):
    bridge.after_commands(5, lambda: harm(bridge))
    code, result = drive()
    assert (code, result["stopped_by"]) == (4, rule)
    assert result["ticks"] < 15
    assert bridge.released.is_set()


@pytest.mark.parametrize(
    ("attribute", "value", "reason"),
    [
        ("drops", "stale", "dropped since then: stale "),
        ("drops", "foreign", "dropped since then: foreign "),
        ("drops", "", "no dropped command"),
        ("gate", None, "no dropped command"),  # the gate publishes no more
    ],
)
def test_a_driver_whose_commands_are_not_accepted_stops_within_half_a_second(
    bridge, drive, attribute, value, reason
):
    bridge.after_commands(5, lambda: setattr(bridge, attribute, value))
    code, result = drive()
    assert (code, result["stopped_by"]) == (4, "not-accepted")
    assert reason in result["reason"]
    refused = [tag.stamp_ns for tag, _ in bridge.commands if tag.sequence > bridge.accepted]
    assert bridge.commands[-1][1] == STILL
    assert (refused[-1] - refused[0]) * 1e-9 < 0.5


def test_a_rover_that_does_not_follow_its_commands_is_stopped(bridge, drive, golden):
    bridge.odom = lambda pose, velocity, stamp: odometry(ODOM_AT_START, STILL, stamp)
    code, result = drive(policy=str(golden), course="parking")
    assert (code, result["stopped_by"]) == (4, "no-response")
    assert result["ticks"] < 60


def test_a_refusal_names_its_reason_moves_nothing_and_leaves_no_recording(bridge, drive, tmp_path):
    bridge.refusal = "stop-button"
    code, result = drive()
    assert (code, result["stopped_by"]) == (4, "stop-button")
    assert "refuses the motors: it is pressed" in result["reason"]
    assert result["recording"] is None
    assert not (tmp_path / "run.mcap").exists()
    assert [velocity for _, velocity in bridge.commands if velocity != STILL] == []


def test_a_second_driver_gets_the_reason(bridge, drive, tmp_path):
    bridge.gate = GateStatus(lease=LEASE + 1)
    bridge.refusal = "another-driver"
    with pytest.raises(AnotherDriver, match="refuses the motors"):
        drive()
    assert not (tmp_path / "run.mcap").exists()
    assert [velocity for _, velocity in bridge.commands if velocity != STILL] == []


def test_a_dry_run_commands_nothing_and_is_done_with_0(bridge, drive, tmp_path):
    code, result = drive(dry_run=True, duration=0.5)
    assert code == 0
    assert result["dry_run"]
    assert result["ticks"] + result["missed"] == 5
    assert bridge.commands == bridge.requests == []
    assert replay(tmp_path / "run.mcap").difference is None


def test_a_router_without_a_bridge_in_our_namespace_is_no_bridge(drive):
    with pytest.raises(NoBridge, match="no bridge is announced there in namespace bot7"):
        drive(namespace="bot7", waits={"bridge_wait_s": 0.3})


def test_a_bridge_without_odometry_has_no_robot(bridge, drive):
    bridge.odom = lambda *sample: None
    with pytest.raises(NoRobot, match="sends no odometry"):
        drive(waits={"odometry_wait_s": 0.3})


def test_interrupted_while_waiting_it_just_ends(bridge, drive, tmp_path):
    bridge.odom = lambda *sample: None
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        drive()
    assert time.monotonic() - began < 4  # it would wait 5 s for odometry
    assert bridge.requests == []
    assert not (tmp_path / "run.mcap").exists()


def test_a_rover_that_moves_before_the_start_is_not_driven(bridge, drive):
    bridge.velocity = Velocity(0.1, 0.0)
    code, result = drive(waits={"still_s": 0.4, "still_wait_s": 1.0})
    assert (code, result["stopped_by"]) == (4, "not-standing")
    assert bridge.requests == []
