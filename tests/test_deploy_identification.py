"""What a robot's profile says against what its mock was made with."""

import json
import math

import numpy as np
import pytest

from deploy import excitation
from deploy.excitation import FENCE_M, excite, steps
from deploy.guard import Guard
from deploy.identification import identify, identify_axis
from deploy.intake import Intake
from deploy.motion_log import MotionLog, Track, motion_log
from deploy.waits import Waits
from rover_ncp.core.errors import FileError, SafetyStop
from rover_ncp.core.geometry import Pose, Velocity, distance
from rover_ncp.core.messages import odometry, twist_stamped
from rover_ncp.core.profile import load_profile
from rover_ncp.core.recording import Recorded
from rover_ncp.shell import run
from sim.pioneer.firmware import Firmware
from sim.pioneer.trial import BaseTrial, rover_of
from sim.studies.identify import errors, identified, robot
from sim.studies.processes import LiveRun
from sim.studies.virtual import Air, World
from sim.world.bay import Bay
from sim.world.randomization import load_randomization
from sim.world.rover import RoverModel


@pytest.mark.parametrize("number", range(2))
def test_robots_nobody_measured_are_identified_from_their_bytes(number):
    trials = robot(load_randomization("full"), 4711, number)
    found = identified(trials)
    off = errors(found, trials)
    assert abs(off.delay_v_s) < 0.02
    assert abs(off.delay_omega_s) < 0.02
    assert abs(off.gain_v) < 0.01
    assert abs(off.gain_omega) < 0.01
    # Odometry alone sees its own scale in everything: up to 3 % of it.
    assert abs(off.true_gain_v) < 0.035
    assert abs(off.accel) < 0.06
    assert abs(off.alpha) < 0.08
    assert found.noise_m == pytest.approx(0.005, rel=0.25)
    assert found.noise_rad == pytest.approx(0.0087, rel=0.25)
    assert (found.odometry_distance, found.slip_s) == (None, None)


def test_external_poses_tell_what_odometry_gets_wrong():
    trials = robot(load_randomization("harsh"), 4711, 0)
    found = identified(trials, outside=True)
    off = errors(found, trials)
    assert abs(off.true_gain_v) < 0.03
    assert found.odometry_distance == pytest.approx(trials.odometry[0, 0], abs=0.02)
    assert found.imbalance_rad_m == pytest.approx(trials.imbalance[0], abs=0.012)
    assert found.slip_s == pytest.approx(trials.slip[0], abs=0.12)


def made(delay, gain, acceleration, *, seconds=30.0, noise=0.0, lost=()):
    """Return the record of a base that does exactly this, its odometry ten times a second."""
    sent_s, sent, at = [], [], 0.4
    for number, step in enumerate(steps()):
        if number not in lost:
            sent_s.append(at)
            sent.append(step.velocity)
        at += step.seconds
    t = np.arange(0.037, at, 0.1)
    fine = np.arange(0.0, at, 0.002)
    motion = np.zeros((len(t), 2))
    for axis in range(2):
        asked = [0.0, *(velocity[axis] for velocity in (step.velocity for step in steps()))]
        times = [0.4 + sum(step.seconds for step in steps()[:number]) for number in range(len(steps()))]
        speed, speeds = 0.0, []
        for now in fine:
            wanted = gain * asked[int(np.searchsorted(times, now - delay, side="right"))]
            step = acceleration * 0.002
            speed = min(max(wanted, speed - step), speed + step)
            speeds.append(speed)
        motion[:, axis] = np.interp(t, fine, speeds)
    motion += np.random.default_rng(1).normal(size=motion.shape) * noise
    return MotionLog(
        np.array(sent_s),
        np.array(sent),
        Track(t, np.zeros((len(t), 3))),
        motion,
        Track(t[:0], np.zeros((0, 3))),
    )


@pytest.mark.parametrize(
    ("delay", "gain", "acceleration"), [(0.0, 1.0, 0.3), (0.31, 0.9, 0.25), (0.57, 1.2, 1.5)]
)
def test_the_fit_finds_what_a_base_was_made_with(delay, gain, acceleration):
    for axis in range(2):
        found = identify_axis(made(delay, gain, acceleration), axis)
        assert found.delay_s == pytest.approx(delay, abs=0.004)
        assert found.gain == pytest.approx(gain, rel=0.003)
        assert found.acceleration == pytest.approx(acceleration, rel=0.05)
        assert found.delay_std < 0.01


def test_a_lost_command_does_not_spoil_the_fit():
    # Commands 5 and 17 are in the record, but the base never heard them: it went on as before.
    log = made(0.2, 1.0, 0.4)
    motion = log.motion.copy()
    late = (log.odometry.t > 12.0) & (log.odometry.t < 12.4)
    motion[late] = 0.0
    found = identify_axis(log._replace(motion=motion), 0)
    assert found.delay_s == pytest.approx(0.2, abs=0.01)
    assert found.gain == pytest.approx(1.0, rel=0.005)


def test_what_was_hardly_asked_for_is_not_known():
    log = made(0.2, 1.0, 0.4)
    sent = log.sent.copy()
    sent[:, 1] = 0.0
    profile = identify(log._replace(sent=sent), "half")
    assert profile.delay_v_s == pytest.approx(0.2, abs=0.01)
    assert (profile.delay_omega_s, profile.gain_omega, profile.alpha) == (None, None, None)


def test_a_record_that_says_nothing_is_refused():
    sample = odometry(Pose(0, 0, 0), Velocity(0, 0), 1_000)
    few = [Recorded("odom", "nav_msgs/msg/Odometry", sample, 1_000, 1_000)] * 3
    with pytest.raises(FileError, match="3 odometry samples and 0 commands"):
        motion_log(few)
    many = few * 30 + [Recorded("rover/cmd_out", "", twist_stamped(Velocity(0.1, 0), 2_000), 1, 1)]
    garbled = [Recorded("odom", "", b"nonsense", 1, 1), Recorded("odom", "", sample[:30], 1, 1)]
    assert len(motion_log(many + garbled).odometry.t) == 90


def excited(trials, fence_m):
    """Drive the steps on a virtual clock; return the farthest from the start, what stopped it, the base."""
    rover = rover_of(trials, RoverModel(), Bay(()))
    start, farthest = rover.pose, [0.0]
    firmware = Firmware(
        "p3at-sh",
        rover,
        trial=BaseTrial(trials),
        observe=lambda now: farthest.append(max(farthest[-1], distance(rover.pose, start))),
    )
    world = World(firmware)
    air = Air(world, start)
    intake = Intake(air.odometry)
    guard = Guard(air, intake, Waits(), lambda: False, world)
    guard.wait(True, "")
    try:
        excite(air, intake, guard, fence_m, world)
        stopped = None
    except SafetyStop as stop:
        stopped = stop.rule
    world.sleep(2.0)
    return farthest[-1], stopped, firmware


def test_the_steps_stay_within_their_fence_and_give_the_motors_back():
    trials = robot(load_randomization("harsh"), 4711, 1)
    farthest, stopped, firmware = excited(trials, FENCE_M)
    assert stopped is None
    assert 0.3 < farthest < FENCE_M
    assert not firmware.drive.enabled
    assert not firmware.drive.moving


def test_a_rover_that_would_leave_the_fence_is_stopped_before_it_does():
    trials = robot(load_randomization("full"), 4711, 1)
    farthest, stopped, firmware = excited(trials, 0.25)
    assert stopped == "geofence"
    assert farthest < 0.27  # a decimetre a second of odometry, 3 % off, and its noise
    assert not firmware.drive.enabled
    assert not firmware.drive.moving


def test_steps_are_what_the_base_takes_as_it_is():
    for velocity, seconds in steps():
        assert velocity.v * 1000 == pytest.approx(round(velocity.v * 1000))
        assert math.degrees(velocity.omega) == pytest.approx(round(math.degrees(velocity.omega)))
        assert seconds > 0


def test_identify_says_what_is_wrong_in_one_line(tmp_path, capsys):
    assert run(["identify"]) == 2
    assert "one of the two" in capsys.readouterr().err
    assert run(["identify", str(tmp_path / "none.mcap"), "--robot", "tcp/127.0.0.1"]) == 2
    capsys.readouterr()
    assert run(["identify", str(tmp_path / "none.mcap")]) == 2
    assert "none.mcap" in capsys.readouterr().err
    assert run(["identify", "--robot", "tcp/127.0.0.1:1", "--out", str(tmp_path / "p.yaml")]) == 3
    assert not (tmp_path / "p.yaml").exists()


def test_a_live_robot_is_identified_and_its_recording_says_the_same(tmp_path, capsys, monkeypatch):
    # A third of the drive: a step each way.
    monkeypatch.setattr(excitation, "steps", lambda: [*steps()[:5], *steps()[15:19]])
    with LiveRun(tmp_path / "log", mock=["--randomize", "full", "--seed", "4711", "--trial", "3"]) as live:
        code = run(
            [
                *("identify", "--robot", live.robot, "--json"),
                *("--out", str(tmp_path / "a.yaml"), "--record", str(tmp_path / "run.mcap")),
            ]
        )
    fields = json.loads(capsys.readouterr().out)
    assert code == 0
    profile = load_profile(tmp_path / "a.yaml")
    assert fields["delay_v_s"] == profile.delay_v_s
    off = errors(profile, robot(load_randomization("full"), 4711, 3))
    assert max(abs(off.delay_v_s), abs(off.delay_omega_s)) < 0.02
    assert max(abs(off.gain_v), abs(off.gain_omega)) < 0.03
    assert run(["identify", str(tmp_path / "run.mcap"), "--out", str(tmp_path / "b.yaml"), "--json"]) == 0
    again = load_profile(tmp_path / "b.yaml")
    assert again.delay_v_s == pytest.approx(profile.delay_v_s, abs=0.005)
    assert again.gain_omega == pytest.approx(profile.gain_omega, rel=0.005)
