"""Identified robot profiles against the true values of the mock."""

import functools

import pytest
from kit.identified import driven, errors, robot, truth

from deploy.identify.excitation import FENCE_M
from deploy.identify.fit import identify
from deploy.identify.motion_log import motion_log
from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.messages import odometry, read_odometry, twist_stamped
from sim.stack.virtual import VirtualLink
from sim.world.randomization import load_randomization

SEED = 4711


@functools.cache
def drive(preset, number=0, *, outside=False):
    """Return the drive of a random robot, its profile, the errors of that, and the robot."""
    ranges = load_randomization("full" if preset == "dead band" else preset)
    if preset == "dead band":
        ranges = ranges.model_copy(update={"dead_band_m_s": (0.03, 0.03), "dead_band_rad_s": (0.1, 0.1)})
    trials = robot(ranges, SEED, number, stiction=0.4 if preset == "dead band" else 0.0)
    done = driven(trials, outside=outside)
    found = identify(motion_log(done.messages, None, done.lasting), "mock", done.bands)
    return done, found, errors(found, truth(ranges, trials)), trials


def test_random_robot_is_identified_from_its_bytes():
    _, found, off, _ = drive("full")
    limits = {"delay_v_s": 0.002, "delay_omega_s": 0.003, "gain_v": 0.003, "gain_omega": 0.01}
    assert [key for key, limit in limits.items() if abs(off[key].error) >= limit] == []
    # Without external poses an acceleration is known no better than odometry's scale, ±3 %.
    assert 0.015 < found.std["accel"] / found.accel < 0.03
    assert all(abs(error) < 3.0 * std for error, std in off.values())
    assert found.noise_m == pytest.approx(0.005, rel=0.25)
    assert found.noise_rad == pytest.approx(0.0087, rel=0.25)
    assert (found.odometry_distance, found.slip_s) == (None, None)
    assert (found.dead_band_v, found.dead_band_omega) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("signs", "words"),
    [((0, 0, 0), "drove 0.000 m where 0.319 m were commanded"), ((1, -1, -1), "turned by -0.3")],
    ids=["frozen", "mirrored"],
)
def test_odometry_that_does_not_show_the_steps_ends_the_drive(signs, words, monkeypatch):
    class FaultyLink(VirtualLink):
        def _receive(self, name, data):
            if name == "odom":
                seen = read_odometry(data)
                pose = Pose(*(sign * value for sign, value in zip(signs, seen.pose, strict=True)))
                velocity = Velocity(signs[0] * seen.velocity.v, signs[2] * seen.velocity.omega)
                data = odometry(pose, velocity, seen.stamp_ns)
            super()._receive(name, data)

    monkeypatch.setattr("kit.identified.VirtualLink", FaultyLink)
    done = driven(robot(load_randomization("full"), SEED, 0))
    assert done.stopped.rule == "no-response"
    assert words in str(done.stopped)
    assert done.farthest_m < 0.5


def test_external_poses_show_the_errors_of_odometry():
    _, found, off, trials = drive("harsh", outside=True)
    assert {"odometry_distance", "wheel_mismatch_rad_m", "slip_s", "accel", "delay_v_s"} <= set(off)
    assert all(abs(error) < 3.0 * std for error, std in off.values())
    assert abs(off["delay_v_s"].error) < 0.003  # although every report is up to 50 ms late
    assert found.odometry_distance == pytest.approx(trials.odometry[0, 0], abs=0.02)
    assert found.wheel_mismatch_rad_m == pytest.approx(trials.wheel_mismatch[0], abs=0.03)
    assert found.slip_s == pytest.approx(trials.slip[0], abs=0.15)


def test_external_poses_show_how_a_robot_skids():
    _, found, off, _ = drive("skid", 1, outside=True)
    assert {"odometry_heading", "rotation_center_m", "alpha"} <= set(off)
    assert all(abs(error) < 3.0 * std for error, std in off.values())
    assert found.odometry_heading < 0.95  # this robot turns more than its wheels say
    assert off["rotation_center_m"].std < 0.005


def test_ramps_show_the_dead_band_and_the_gains_beyond_it():
    _, found, off, _ = drive("dead band")
    assert (found.dead_band_v, found.dead_band_omega) == (0.03, pytest.approx(0.1, abs=0.02))
    assert abs(off["gain_v"].error) < 0.003
    assert abs(off["gain_omega"].error) < 0.01


def test_a_record_that_says_nothing_is_refused():
    sample = odometry(Pose(0, 0, 0), Velocity(0, 0), 1_000)
    few = [Recorded("odom", "nav_msgs/msg/Odometry", sample, 1_000, 1_000)] * 3
    with pytest.raises(FileError, match="3 odometry samples and 0 commands"):
        motion_log(few)
    many = few * 30 + [Recorded("rover/cmd_out", "", twist_stamped(Velocity(0.1, 0), 2_000), 1, 1)]
    garbled = [Recorded("odom", "", b"nonsense", 1, 1), Recorded("odom", "", sample[:30], 1, 1)]
    assert len(motion_log(many + garbled).odometry.t) == 90


def test_the_steps_stay_within_their_fence_and_give_the_motors_back():
    done, *_ = drive("harsh", outside=True)
    assert done.stopped is None
    assert 0.3 < done.farthest_m < FENCE_M
    assert (done.base.drive.enabled, done.base.drive.rover.moving) == (False, False)


def test_a_rover_that_would_leave_the_fence_is_stopped_before_it_does():
    done = driven(robot(load_randomization("full"), SEED, 1), fence_m=0.25)
    assert done.stopped.rule == "geofence"
    assert done.farthest_m < 0.27  # a decimetre a second of odometry, 3 % off, and its noise
    assert (done.base.drive.enabled, done.base.drive.rover.moving) == (False, False)
