"""The driver's measurements beside odometry: external poses and a gyro, over real Zenoh."""

import dataclasses
import math

import pytest
from kit.deploy_bench import ODOM_AT_START, STILL

from deploy.drive.records import TICKS_TOPIC, TickRecord
from deploy.replay import replay
from rover_ncp.core.errors import NoPose
from rover_ncp.core.geometry import Pose, compose, distance, inverse
from rover_ncp.recording.recording import read_recording, rewrite
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import imu, odometry, pose_with_covariance, read_pose, read_text
from rover_ncp.wire.protocol import parse_json


def localised(bridge, course_odom, frame="course"):
    """Publish with each odometry where the one before it was on the course."""
    late, covariance = [], [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 3e-4]]

    def odom(pose, velocity, stamp):
        late.append(pose_with_covariance(compose(course_odom, pose), covariance, stamp, frame))
        if len(late) > 1:
            bridge.publish_pose(late.pop(0))
        return odometry(pose, velocity, stamp)

    return odom


def test_an_external_pose_places_the_rover_on_the_course(bridge, drive, tmp_path):
    there = Pose(0.2, 0.1, 0.3)
    bridge.odom = localised(bridge, compose(there, inverse(ODOM_AT_START)))
    code, result = drive(duration=0.5, pose="required")
    assert code == 1
    assert result["pose"]["placed"]
    assert result["pose"]["used"] >= 3
    assert result["pose"]["refused"] == result["pose"]["unreadable"] == 0
    recording = read_recording(tmp_path / "run.mcap")
    first = read_pose(recording.topic("rover/estimate")[0].data).pose
    assert distance(first, there) < 1e-6
    assert first.theta == pytest.approx(0.3)
    assert replay(tmp_path / "run.mcap").difference is None


@pytest.mark.parametrize(
    "there", [Pose(-3.25, 0.0, 2.48), Pose(0.0, 0.0, math.pi), Pose(0.1, -0.21, 0.0), Pose(0.5, 0.1, 0.3)]
)
@pytest.mark.parametrize("pose", ["required", "auto"])
def test_a_start_for_which_no_rate_is_known_is_refused_before_the_motors(bridge, drive, there, pose):
    bridge.odom = localised(bridge, compose(there, inverse(ODOM_AT_START)))
    code, result = drive(duration=0.5, pose=pose)
    assert (code, result["stopped_by"], bridge.requests, bridge.commands) == (4, "start-pose", [], [])
    assert f"x {there.x:.2f} m, y {there.y:.2f} m" in result["reason"]
    assert "(limit ±0.2 m and ±20°)" in result["reason"]


def test_a_gyros_readings_count_are_recorded_and_recomputed(bridge, drive, tmp_path):
    def odom(pose, velocity, stamp):
        bridge.session.put(key("", "imu"), imu(velocity.omega + 0.3, 1e-6, stamp))
        return odometry(pose, velocity, stamp)

    bridge.odom = odom
    code, result = drive()
    assert code == 1
    assert result["odometry"]["rejected"] == 0
    recording = read_recording(tmp_path / "run.mcap")
    records = [parse_json(TickRecord, read_text(m.data)) for m in recording.topic(TICKS_TOPIC)]
    taken = [ref for record in records for ref in record.samples if ref.topic == "imu"]
    assert len(taken) > 10
    assert replay(tmp_path / "run.mcap").difference is None

    silent = tuple(message for message in recording.messages if message.topic != "imu")
    rewrite(dataclasses.replace(recording, messages=silent), tmp_path / "silent.mcap")
    difference = replay(tmp_path / "silent.mcap").difference
    assert difference.quantity.startswith("the gyro reading of stamp")


def test_without_external_poses_the_start_is_the_origin_or_an_error(bridge, drive, tmp_path):
    with pytest.raises(NoPose, match="no external pose of the rover arrived on 'pose'") as caught:
        drive(pose="required", waits={"pose_wait_s": 0.5})
    assert caught.value.exit_code == 3
    assert bridge.requests == []
    bridge.odom = localised(bridge, Pose(9.0, 9.0, 1.0))
    drive(duration=0.3, pose="none")
    first = read_pose(read_recording(tmp_path / "run.mcap").topic("rover/estimate")[0].data).pose
    assert distance(first, Pose(0, 0, 0)) < 1e-6


def test_poses_that_come_only_after_the_start_are_not_used_and_that_is_said(bridge, drive):
    there = localised(bridge, Pose(9.0, 9.0, 1.0))

    def odom(*sample):
        return there(*sample) if bridge.commands else odometry(*sample)

    bridge.odom = odom
    code, said = drive(as_json=False, duration=0.6)
    assert code == 1
    words = " ".join(said.split())
    assert "external poses came, but none while the rover stood at the start: none was used" in words


def test_poses_in_another_frame_and_garbled_ones_count_for_nothing(bridge, drive, tmp_path):
    bridge.odom = localised(bridge, Pose(9.0, 9.0, 1.0), frame="map")
    bridge.after_commands(1, lambda: bridge.publish_pose(b"nonsense"))
    code, result = drive(duration=0.5)
    assert code == 1
    assert result["pose"]["unreadable"] > 3
    assert result["pose"]["taken"] == 0


def test_a_rover_that_was_carried_away_is_stopped(bridge, drive, tmp_path):
    placed = localised(bridge, inverse(ODOM_AT_START))
    elsewhere = localised(bridge, compose(Pose(0.0, 0.4, 0.0), inverse(ODOM_AT_START)))

    def odom(*sample):
        return placed(*sample) if len(bridge.commands) < 8 else elsewhere(*sample)

    bridge.odom = odom
    code, result = drive()
    assert (code, result["stopped_by"]) == (4, "external-pose")
    assert "5 external poses rejected in a row" in result["reason"]
    assert result["ticks"] < 16
    assert bridge.commands[-1][1] == STILL
    estimates = [
        read_pose(m.data).pose for m in read_recording(tmp_path / "run.mcap").topic("rover/estimate")
    ]
    assert max(abs(pose.y) for pose in estimates) < 0.05  # it never believed it
    assert replay(tmp_path / "run.mcap").difference is None


def test_without_the_required_accuracy_the_rover_is_not_driven(bridge, drive, tmp_path):
    code, result = drive(require_accuracy=0.01)
    assert (code, result["stopped_by"]) == (4, "accuracy")
    assert result["predicted_error_m"] > 0.01
    assert "expected 0.01 m at most" in result["reason"]
    assert result["reason"].endswith("external poses or a gyro or a profile of 'identify' would reduce it")
    (tmp_path / "mine.yaml").write_text("{name: mine, gain_v: 1.0}")
    code, result = drive(require_accuracy=0.01, profile=tmp_path / "mine.yaml")
    assert result["reason"].endswith("external poses or a gyro would reduce it")
    assert bridge.requests == []
    bridge.odom = localised(bridge, inverse(ODOM_AT_START))
    code, result = drive(require_accuracy=0.01, duration=0.3)
    assert (code, result["stopped_by"]) == (1, None)
