"""Identified robot profiles against the true values of the mock."""

import functools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from kit.described import described
from kit.identified import driven, errors, robot, truth

from deploy.identify.axis_fit import OdometryErrors, identify_axis
from deploy.identify.excitation import FENCE_M, ramps, steps
from deploy.identify.fit import dead_bands, identify
from deploy.identify.motion_log import MotionLog, Track, motion_log
from deploy.identify.run import _lines
from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import odometry, pose_with_covariance, read_odometry, read_pose, twist_stamped
from sim.stack.virtual import VirtualLink
from sim.world.randomization import load_randomization
from sim.world.rover import toward

SEED = 4711


@functools.cache
def drive(preset, number=0, *, outside=False):
    """Return the drive of a random robot, its profile, the errors of that, and the robot."""
    ranges = load_randomization("full" if preset == "dead band" else preset)
    if preset == "dead band":
        ranges = ranges.model_copy(update={"dead_band_m_s": (0.03, 0.03), "dead_band_rad_s": (0.1, 0.1)})
    trials = robot(ranges, SEED, number, stiction=0.4 if preset == "dead band" else 0.0)
    done = driven(trials, outside=outside)
    found = identify(motion_log(done.messages), "mock")
    return done, found, errors(found, truth(ranges, trials)), trials


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.long)])
def test_random_robots_are_identified_from_their_bytes(number):
    _, found, off, _ = drive("full", number)
    limits = {"delay_v_s": 0.002, "delay_omega_s": 0.003, "gain_v": 0.003, "gain_omega": 0.01}
    assert [key for key, limit in limits.items() if abs(off[key].error) >= limit] == []
    # Without external poses an acceleration is known no better than odometry's scale, ±3 %.
    assert 0.015 < found.std["accel"] / found.accel < 0.03
    assert all(abs(error) < 3.0 * std for error, std in off.values())
    assert found.noise_m == pytest.approx(0.005, rel=0.25)
    assert found.noise_rad == pytest.approx(0.0087, rel=0.25)
    assert (found.odometry_distance, found.slip_s) == (None, None)
    assert (found.dead_band_v, found.dead_band_omega) == (0.0, 0.0)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_odometry_that_reports_no_speed_or_far_too_little_gives_no_gain(share):
    def weakened(message):
        if message.topic != "odom":
            return message
        seen = read_odometry(message.data)
        velocity = Velocity(share * seen.velocity.v, share * seen.velocity.omega)
        pose = seen.pose if share == 0.0 else Pose(*(share * value for value in seen.pose))
        return replace(message, data=odometry(pose, velocity, seen.stamp_ns))

    found = identify(motion_log([weakened(each) for each in drive("full")[0].messages]), "mock")
    assert (found.gain_v, found.gain_omega) == (None, None)


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        ((0, 0, 0), "drove 0.000 m where 0.319 m were commanded"),
        ((-1, 1, -1), "drove -0.2"),
        ((1, -1, -1), "turned by -0.3"),
    ],
    ids=["frozen", "backward", "mirrored"],
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


@pytest.mark.parametrize("frame", ["map", "", "robot1/world"])
def test_external_poses_count_in_any_one_frame(frame, caplog):
    done, found, *_ = drive("full", outside=True)
    poses = [n for n, message in enumerate(done.messages) if message.topic == "pose"]
    messages = list(done.messages)
    for n in poses[5:]:  # five of another localiser are left out, with a warning
        sample = read_pose(messages[n].data)
        data = pose_with_covariance(sample.pose, sample.covariance, sample.stamp_ns, frame)
        messages[n] = replace(messages[n], data=data)
    again = identify(motion_log(messages), "mock")
    assert again.measured["external_poses"] == len(poses) - 5
    assert again.odometry_heading == pytest.approx(found.odometry_heading, rel=1e-3)
    assert f"used in frame '{frame}' only; left out: 5 in frame 'course'" in caplog.text


def test_tyres_that_rock_after_a_motion_do_not_hide_how_a_robot_skids():
    log, rocking = motion_log(drive("skid", outside=True)[0].messages), []
    still = (np.abs(log.motion) < (0.004, 0.006)).all(axis=1)
    motion, stands = log.motion.copy(), np.flatnonzero(np.diff(still.astype(int)) == 1) + 1
    for begin in stands.tolist():
        if still[begin : begin + 14].sum() == 14:
            rocking += [begin + 6, begin + 12]
    motion[rocking, 1] = 0.007
    assert len(rocking) > 8
    quiet, rocked = identify(log, "mock"), identify(log._replace(motion=motion), "mock")
    assert rocked.rotation_center_m == pytest.approx(quiet.rotation_center_m, abs=0.005)
    assert rocked.odometry_heading == pytest.approx(quiet.odometry_heading, abs=0.02)


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


def test_soft_tyres_that_wind_up_before_they_turn_the_rover_are_no_dead_band():
    """As MuJoCo's, which take a second at 0.02 rad/s."""
    held_s, rate, t, sent, motion = 0.0, 0.0, [], [], []
    newest = SimpleNamespace(sample=SimpleNamespace(velocity=Velocity(0.005, 0.0)))
    for step in ramps(SimpleNamespace(newest=newest)):
        for _ in range(13):
            held_s = held_s + 0.05 if step.velocity.omega else 0.0
            rate = step.velocity.omega if held_s > 1.0 else 0.0
            t.append(0.05 * len(t))
            sent.append(step.velocity)
            motion.append((step.velocity.v, rate))
        newest.sample.velocity = Velocity(step.velocity.v, rate)
    t = np.array(t)
    assert dead_bands(log_of(t, np.array(sent), t + 0.025, np.array(motion))) == (0.0, 0.0)


def log_of(sent_s, sent, t, motion):
    """Return the log of commands and of motion at times ``t``, without any pose."""
    none = Track(t[:0], np.zeros((0, 3)))
    return MotionLog(sent_s, sent, Track(t, np.zeros((len(t), 3))), motion, none)


@pytest.mark.parametrize(
    ("follows", "band"),
    [
        ([], None),
        ([0.1], None),
        ([0.005], 0.0),
        ([-0.005, -0.01, 0.015, 0.1], 0.015),
        ([-0.005, -0.01, 0.1], None),  # the ramp ended early
        ([0.005, -0.1], None),
    ],
)
def test_dead_band_is_between_two_steps_of_a_ramp(follows, band):
    """Commands that a robot follows, and with a minus those that it does not."""
    parts = [speed for each in follows for speed in (each, 0.0)] or [0.0]
    t = np.arange(0.0, len(parts) * 0.65, 0.1)
    at = np.minimum((t / 0.65).astype(int), len(parts) - 1)
    sent, motion = (np.column_stack([v, 0.0 * v]) for v in (np.abs(parts), np.maximum(parts, 0.0)))
    log = log_of(np.arange(len(parts)) * 0.65, sent, t, motion[at])
    assert dead_bands(log) == (band, None)


STEPS = (0.001, math.radians(0.1))
"""In which a Pioneer reports speed and turn rate."""


def made(delay, gain, acceleration, deceleration=None, *, rounded=False):
    """Return the record of a base that does exactly this on both axes, its odometry ten times a second."""
    velocities = np.array([step.velocity for step in steps()])
    ends = 0.4 + np.cumsum([step.seconds for step in steps()])
    begins = np.concatenate([[0.4], ends[:-1]])
    t = np.arange(0.037, ends[-1], 0.1)
    motion = np.zeros((len(t), 2))
    for axis in range(2):
        before = gain * np.concatenate([[0.0], velocities[:-1, axis]])
        after = gain * velocities[:, axis]
        braking = np.abs(after) < np.abs(before)
        limit = np.where(braking, deceleration or acceleration, acceleration)
        reached = begins + delay + np.abs(after - before) / limit
        knots = np.column_stack([begins + delay, reached]).ravel()
        motion[:, axis] = np.interp(t, knots, np.column_stack([before, after]).ravel())
        if rounded:
            motion[:, axis] = np.rint(motion[:, axis] / STEPS[axis]) * STEPS[axis]
    return log_of(begins, velocities, t, motion)


@pytest.mark.parametrize(
    ("delay", "gain", "acceleration"), [(0.0, 1.0, 0.3), (0.31, 0.9, 0.25), (0.57, 1.2, 0.6)]
)
def test_fit_finds_delay_gain_and_acceleration(delay, gain, acceleration):
    found = identify(made(delay, gain, acceleration), "exact")
    assert (found.delay_v_s, found.delay_omega_s) == pytest.approx((delay, delay), abs=0.004)
    assert (found.gain_v, found.gain_omega) == pytest.approx((gain, gain), rel=0.003)
    assert found.accel == pytest.approx(acceleration, rel=0.05)


def followed(sent_s, sent, delay, accel, decel):
    """Return the record of a base that moves as the simulators do: both axes alike, odometry at 10 Hz."""
    at, speed = 0.001 * np.arange(round(1000 * (sent_s[-1] + 3.0))), [0.0]
    for now in at[1:]:
        due = np.searchsorted(sent_s + delay, now + 1e-9)
        speed.append(toward(speed[-1], sent[due - 1] if due else 0.0, 0.001 * accel, 0.001 * decel))
    t = np.arange(0.037, at[-1], 0.1)
    return log_of(sent_s, np.column_stack([sent] * 2), t, np.column_stack([np.interp(t, at, speed)] * 2))


def test_a_command_that_reverses_first_brakes():
    # No rest between forward and back: the base brakes to 0 and then speeds up.
    log = followed(1.0 + 3.03 * np.arange(12), np.tile([0.2, -0.2, 0.0], 4), 0.2, 0.3, 0.6)
    found = identify_axis(log, 0, OdometryErrors(np.array([1.0, 0.0]), np.zeros((2, 2))))
    assert found.values[1] == pytest.approx(1.0, abs=0.002)
    assert found.values[2:] == pytest.approx([0.3, 0.6], rel=0.02)


def test_an_acceleration_that_no_command_shows_leaves_the_rest_known():
    # The gate raises the command by 0.02 m/s each 20 ms, which the base does at once, and brakes at once.
    climb = np.append(0.02 * np.arange(1, 11), 0.0)
    begins = 1.0 + 4.06 * np.arange(6)
    sent_s = np.concatenate([begin + np.append(0.02 * np.arange(10), 2.1) for begin in begins])
    found = identify(followed(sent_s, np.tile(climb, 6), 0.2, 4.0, 0.5), "burger")
    assert found.delay_v_s == pytest.approx(0.2, abs=0.004)
    assert found.gain_v == pytest.approx(1.0, abs=0.002)
    assert found.decel == pytest.approx(0.5, rel=0.05)
    assert found.accel is None


def test_lost_command_does_not_disturb_the_fit():
    log = made(0.2, 1.0, 0.4, rounded=True)
    late = (log.odometry.t > 12.0) & (log.odometry.t < 12.4)
    found = identify(log._replace(motion=log.motion * ~late[:, None]), "lost")
    assert found.delay_v_s == pytest.approx(0.2, abs=0.005)
    assert found.gain_v == pytest.approx(1.0, rel=0.005)
    assert found.std["delay_v_s"] < 0.005


def test_axis_without_commands_is_not_known():
    log = made(0.2, 1.0, 0.4)
    profile = identify(log._replace(sent=log.sent * [1.0, 0.0]), "half")
    assert profile.delay_v_s == pytest.approx(0.2, abs=0.01)
    assert (profile.delay_omega_s, profile.gain_omega, profile.alpha) == (None, None, None)


@pytest.mark.parametrize("bases", [10, pytest.param(40, marks=pytest.mark.long)])
def test_intervals_cover_the_truth(bases):
    """Intervals of 95 % of random bases, eight values each.

    If those of 40 bases are exact, 85 % or fewer hold the truth with a probability below 1e-8 if all are
    independent, and of 0.4 % if the eight of a base always miss together. At most one value in five is left
    out: a ramp shorter than the time between two reports shows no acceleration.
    """
    random = np.random.default_rng(20261122)
    ratios = []
    for _ in range(bases):
        true = random.uniform([0.05, 0.9, 0.2, 0.2], [0.3, 1.1, 1.6, 1.6])
        log = made(*true, rounded=True)
        known = OdometryErrors(np.array([1.0, 0.0]), np.zeros((2, 2)))
        for axis in range(2):
            found = identify_axis(log, axis, known)
            ratios.append((found.values - true) / found.std)
    known = np.abs(np.ravel(ratios)[np.isfinite(np.ravel(ratios))])
    assert len(known) > 0.8 * np.size(ratios)
    assert np.mean(known < 1.96) > 0.85
    assert np.median(known) > 0.3  # 0.67 if exact: intervals are not wide for safety


def test_acceleration_that_no_command_asks_for_is_left_out():
    # The command changes so slowly that the base follows it with any acceleration beyond 0.1 m/s².
    t = np.arange(0.037, 40.0, 0.1)
    sent_s = np.arange(0.0, 40.0, 0.05)
    sent = np.column_stack([0.1 - 0.1 * np.cos(0.8 * sent_s), 0.3 * np.sin(0.8 * sent_s)])
    noise = np.random.default_rng(0).normal(size=(len(t), 2)) * [0.003, 0.01]
    motion = np.column_stack([np.interp(t - 0.2, sent_s, column) for column in sent.T]) + noise
    found = identify(log_of(sent_s, sent, t, motion), "slow")
    assert (found.accel, found.alpha) == (None, None)


@pytest.mark.parametrize("heading_scale", [1.0, 30.0])
def test_heading_errors_are_left_out_when_the_rover_hardly_turned(heading_scale):
    # Many stands, with straight ways between: headings differ by their noise alone.
    log = made(0.2, 1.0, 0.4, rounded=True)
    motion, t = log.motion * [1.0, 0.0], log.odometry.t
    way = np.concatenate([[0.0], np.cumsum(motion[:-1, 0] * np.diff(t))])
    truth = np.column_stack([way, 0.0 * way, 0.0 * way])
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(size=(2, len(t), 3)) * [0.005, 0.005, 0.0087]
        noise[0, :, 2] *= heading_scale
        own, outside = Track(t, truth + noise[0]), Track(t, truth + noise[1])
        found = identify(log._replace(motion=motion, odometry=own, external=outside), "straight")
        assert found.odometry_distance == pytest.approx(1.0, abs=0.03)
        assert (found.odometry_heading, found.slip_s) == (None, None)


def test_slip_beyond_any_base_is_left_out():
    # The heading that odometry reports turns further than the true one by more slip than a base can have.
    log = made(0.2, 1.0, 2.0, rounded=True)
    t, omega = log.odometry.t, log.motion[:, 1]
    own = np.concatenate([[0.0], np.cumsum(omega[:-1] * np.diff(t))])
    true = np.concatenate([[0.0], np.cumsum((omega - 4.0 * np.abs(omega) * omega)[:-1] * np.diff(t))])
    tracks = [Track(t, np.column_stack([0.0 * t, 0.0 * t, heading])) for heading in (own, true)]
    found = identify(log._replace(odometry=tracks[0], external=tracks[1]), "slips")
    assert found.slip_s is None


def test_late_reports_do_not_count_as_delay():
    cycle = 0.1 * np.arange(300)
    late = np.random.default_rng(3).uniform(0.0, 0.05, 300)
    late[7] = late[191] = 0.0
    stamps = np.round((1.0 + cycle + late) * 1e9).astype(np.int64)
    messages = [
        Recorded("odom", "", odometry(Pose(0, 0, 0), Velocity(0, 0), int(stamp)), int(stamp), int(stamp))
        for stamp in stamps
    ]
    command = Recorded("rover/cmd_out", "", twist_stamped(Velocity(0.1, 0), 1_000_000_000), 1, 1)
    times = motion_log([*messages, command]).odometry.t
    assert times == pytest.approx(cycle - late[0], abs=0.002)


def test_text_shows_a_standard_deviation_with_each_value():
    lines = _lines(drive("full")[1])
    assert [line.split()[0] for line in lines[:2]] == ["delay_v_s", "delay_omega_s"]
    assert all("±" in line for line in lines if line.startswith(("delay", "gain", "accel")))


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


def test_steps_are_what_the_base_takes_as_it_is():
    for velocity, seconds in steps():
        assert velocity.v * 1000 == pytest.approx(round(velocity.v * 1000))
        assert math.degrees(velocity.omega) == pytest.approx(round(math.degrees(velocity.omega)))
        assert seconds > 0


def test_a_slow_robot_is_driven_within_its_limits():
    slow = described("turtlebot3-burger", motion={"v_max": 0.1, "omega_max": 0.2})
    velocities = np.abs([step.velocity for step in steps(slow)])
    assert velocities.max(axis=0) == pytest.approx([0.1, 0.2])
    assert steps(load_description("turtlebot3-burger")) == steps()
