"""Start, measurements and result of a drive, on the virtual clock before a real bridge and base."""

import dataclasses
import math

import numpy as np
import pytest
from kit.paths import DATA
from kit.virtual_drive import COURSE, VirtualDrive, short_course

from deploy.drive.records import TICKS_TOPIC, TickRecord
from deploy.replay import replay
from rover_ncp.circuit.policy_file import load_policy
from rover_ncp.core.geometry import ORIGIN, STANDSTILL, Pose, compose, distance, wrap_angle
from rover_ncp.course.course import load_course
from rover_ncp.course.scoring import SURE, Parked
from rover_ncp.recording.recording import read_recording, rewrite
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.messages import imu, pose_with_covariance, read_pose, read_text
from rover_ncp.wire.protocol import parse_json

COVARIANCE = np.diag([1e-4, 1e-4, 3e-4])
ARC = load_course(DATA / "arc_course.yaml")


def localised(link, start=ORIGIN, frame="course", rng=None):
    """Have each odometry bring the external pose of the one before; the rover began at ``start``.

    With an ``rng``, poses have errors of their covariance.
    """
    waiting = []

    def poses(sample):
        seen = compose(start, sample.pose)
        if rng is not None:
            seen = Pose(*rng.multivariate_normal(seen, COVARIANCE))
        waiting.append(pose_with_covariance(seen, COVARIANCE, sample.stamp_ns, frame))
        return [waiting.pop(0)] if len(waiting) > 1 else []

    link.put_with_odometry("pose", poses)


def posed(there=ORIGIN, pose="required", **settings):
    """A drive whose external poses begin at ``there``."""
    virtual = VirtualDrive(pose=pose, **settings)
    localised(virtual.link, there)
    return virtual


def estimates(virtual):
    return [read_pose(data).pose for data in virtual.messages("rover/estimate")]


@pytest.mark.parametrize("there", [Pose(0.0, 0.0, math.pi), Pose(0.5, 0.1, 0.3)])
def test_start_for_which_no_rate_is_known_is_refused_before_the_motors(there):
    virtual = posed(there, "auto")
    result = virtual.run()
    assert (result.exit_code, result.stopped_by, virtual.link.requests) == (4, "start-pose", 0)
    assert f"x {there.x:.2f} m, y {there.y:.2f} m" in result.reason
    assert "(limit ±0.3 m and ±20°)" in result.reason


def test_readings_of_a_gyro_count_are_recorded_and_recomputed(tmp_path):
    virtual = VirtualDrive(path=tmp_path / "run.mcap")
    virtual.link.put_with_odometry(
        "imu", lambda sample: [imu(sample.velocity.omega + 0.3, 1e-6, sample.stamp_ns)]
    )
    result = virtual.run()
    assert (result.exit_code, result.odometry.rejected) == (1, 0)
    records = [parse_json(TickRecord, read_text(data)) for data in virtual.messages(TICKS_TOPIC)]
    taken = [ref for record in records for ref in record.samples if ref.topic == "imu"]
    assert len(taken) > 10
    assert replay(virtual.path).difference is None

    recording = read_recording(virtual.path)
    silent = tuple(message for message in recording.messages if message.topic != "imu")
    rewrite(dataclasses.replace(recording, messages=silent), tmp_path / "silent.mcap")
    difference = replay(tmp_path / "silent.mcap").difference
    assert difference.quantity.startswith("the gyro reading of stamp")


def test_drive_without_external_poses_starts_at_the_origin():
    virtual = posed(Pose(9.0, 9.0, 1.0), "none", ticks=5)
    virtual.run()
    assert distance(estimates(virtual)[0], ORIGIN) < 1e-6


def test_moving_rover_does_not_start():
    virtual = VirtualDrive()
    virtual.link.change_odometry(lambda _: (Pose(0.0, 0.0, 0.03 * virtual.bridge.monotonic()), STANDSTILL))
    result = virtual.run()
    assert (result.exit_code, result.stopped_by, virtual.link.requests) == (4, "not-standing", 0)


@pytest.mark.parametrize(("pose", "silent_s"), [("required", 0.4), ("auto", 9.0)])
def test_poses_that_stop_end_no_drive_if_they_resume_in_time_or_are_not_required(tmp_path, pose, silent_s):
    virtual = posed(pose=pose, pose_age_s=0.6, path=tmp_path / "run.mcap")
    link, bridge = virtual.link, virtual.bridge
    poses = link.change["odom"]

    def lose_poses():
        until_ns = bridge.now_ns + silent_s * 1e9
        link.change["odom"] = lambda data: data if bridge.now_ns < until_ns else poses(data)

    link.harm = lose_poses
    result = virtual.run()
    assert (result.stopped_by, result.exit_code) == (None, 1)
    assert replay(virtual.path).difference is None


NEAR = short_course(position_m=1.0, heading_rad=0.02, still_m=1.0, still_rad=1.0, still_s=0.1)
"""A rover that drives straight ahead parks here; encoders alone leave its heading uncertain."""


@pytest.mark.parametrize(("required", "exit_code"), [(False, 0), (True, 1)])
def test_an_uncertain_verdict_says_what_would_help_and_fails_if_certainty_is_required(required, exit_code):
    virtual = VirtualDrive(course=NEAR, require_certainty=required)
    result = virtual.run()
    assert (result.exit_code, result.verdict, result.stopped_by) == (exit_code, Parked.UNCERTAIN, None)
    assert 0.0 < result.probability < SURE
    last = virtual.link.statuses[-1]
    assert (last.state, last.probability) == ("parked, uncertain", result.probability)
    assert result.reason.endswith("external poses or a gyro or a profile of 'identify' would reduce it")


def test_a_rover_that_stands_needs_no_further_poses():
    waits = NEAR.model_copy(update={"start_signal_s": 2.0})
    virtual = posed(policy=load_policy("course"), course=waits, pose_age_s=1.6)  # of 2 s it rests 0.5 s
    virtual.link.after, virtual.link.harm = 1, virtual.link.change.clear
    result = virtual.run()
    assert (result.stopped_by, result.ticks) == (None, waits.ticks)


def test_dry_run_commands_nothing_and_is_done_with_0(tmp_path):
    virtual = VirtualDrive(dry_run=True, path=tmp_path / "run.mcap")
    result = virtual.run()
    assert (result.exit_code, result.dry_run, result.ticks) == (0, True, COURSE.ticks)
    assert (virtual.link.sent, virtual.link.requests) == ([], 0)
    assert replay(virtual.path).difference is None


def test_rover_with_an_external_start_pose_parks_on_the_true_pose(tmp_path):
    start, course = Pose(0.07, -0.09, 0.15), load_course("parking")
    virtual = VirtualDrive(load_policy("course"), course, tmp_path / "run.mcap", pose="required")
    localised(virtual.link, start, rng=np.random.default_rng(1))
    result = virtual.run()
    assert (result.exit_code, result.verdict) == (0, Parked.YES)
    assert (result.pose.placed, result.pose.refused, result.pose.unreadable) == (True, 0, 0)
    assert result.pose.used > 50
    end = compose(start, virtual.rover.pose)
    # Without external poses the final position error would be as large as that of the start.
    assert distance(end, course.goal) < course.parked.position_m / 2 < distance(start, ORIGIN)
    assert abs(wrap_angle(end.theta - course.goal.theta)) < course.parked.heading_rad
    assert replay(virtual.path).difference is None
    # What viewers show: where odometry lies on the course, and the way.
    [frames], [way] = (
        [decode(message.type, message.data) for message in virtual.recorded if message.topic == topic]
        for topic in ("deploy/frames", "deploy/path")
    )
    odom = frames.transforms[0].transform.translation
    assert (odom.x, odom.y) == pytest.approx(start[:2], abs=0.02)
    assert [way.poses[-1].pose.position.x] == pytest.approx([end.x], abs=0.03)


def test_two_localisers_that_disagree_at_the_start_leave_the_verdict_uncertain():
    virtual = VirtualDrive(load_policy("course"), ARC, pose="required")

    def poses(sample):
        far = Pose(sample.pose.x + 0.15, sample.pose.y, sample.pose.theta)
        seen = [far] if virtual.link.lease.number else [sample.pose, far]
        return [pose_with_covariance(pose, COVARIANCE, sample.stamp_ns, "course") for pose in seen]

    virtual.link.put_with_odometry("pose", poses)
    result = virtual.run()
    assert result.stopped_by is None
    assert result.verdict is not Parked.YES


def test_motion_without_poses_adds_up_over_rests():
    waits = NEAR.model_copy(update={"start_signal_s": 2.0})
    virtual = posed(policy=load_policy("course"), course=waits, pose_age_s=0.7)
    virtual.link.after, virtual.link.harm = 1, virtual.link.change.clear
    assert virtual.run().stopped_by == "pose-age"
