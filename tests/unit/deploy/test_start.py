"""The start of a drive on a virtual clock: rest within odometry's noise, external poses of that time."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from deploy.drive import start
from deploy.drive.config import DriveConfig, settings_for
from deploy.drive.link import Arrival, Inbox
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.start import StartDetector
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import NoPose, SafetyStop
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.wire.messages import COURSE_FRAME, odometry, pose_with_covariance
from rover_ncp.wire.protocol import GateStatus

COVARIANCE = np.diag([1e-4, 1e-4, 1e-3])


class World:
    """A clock that publishes odometry and poses as it advances; also the link's inboxes."""

    robot, where, bridge_alive, gate = "fake", "", True, GateStatus()

    def __init__(self, odometry_at, pose_at=lambda t: None, period=0.05):
        self.odometry, self.gyro, self.poses = Inbox(1), Inbox(), Inbox()
        self.now_ns, self._due_ns = 0, 0
        self._at, self._pose_at, self._period_ns = odometry_at, pose_at, round(period * NS_PER_S)

    def monotonic(self):
        return self.now_ns / NS_PER_S

    def monotonic_ns(self):
        return self.now_ns

    def sleep(self, seconds):
        self.now_ns += round(seconds * NS_PER_S)
        while self._due_ns <= self.now_ns:
            t = self._due_ns / NS_PER_S
            data = odometry(Pose(*self._at(t)), Velocity(0.0, 0.0), self._due_ns)
            self.odometry.put(Arrival(data, self._due_ns))
            if (seen := self._pose_at(t)) is not None:
                pose = pose_with_covariance(*seen, self._due_ns, COURSE_FRAME)
                self.poses.put(Arrival(pose, self._due_ns))
            self._due_ns += self._period_ns


def detect(world, **settings):
    config = DriveConfig(
        robot="fake", namespace="", policy="p", course="c", dry_run=False, ticks=1, **settings
    )
    measurements = Measurements(world)
    detector = StartDetector(world, measurements, config, world)
    detector.wait(SafetyMonitor(world, measurements, lambda: False, config, world))
    return detector


@pytest.mark.parametrize("noise_m", [0.0, 0.001, 0.005, 0.02])
@pytest.mark.parametrize("noise_rad", [0.0, 0.02])
def test_noisy_odometry_at_rest_starts_if_its_noise_is_declared(noise_m, noise_rad):
    for seed in range(5):
        random = np.random.default_rng(seed)
        world = World(lambda t, random=random: random.normal(size=3) * [noise_m, noise_m, noise_rad])
        profile = RoverProfile(name="noisy", noise_m=noise_m, noise_rad=noise_rad)
        detect(world, estimator=settings_for(profile))
        assert world.monotonic() < 3.0


@pytest.mark.parametrize("way", [(0.02, 0.0, 0.0), (0.0, -0.02, 0.0), (0.0, 0.0, 0.03)])
def test_moving_rover_does_not_start(way):
    with pytest.raises(SafetyStop) as caught:
        detect(World(lambda t: np.array(way) * t))
    assert caught.value.rule == "not-standing"


def test_each_pose_is_checked_once_and_invalid_ones_are_left_out(monkeypatch):
    checked = []
    once = start.completed
    monkeypatch.setattr(start, "completed", lambda *given: checked.append(1) or once(*given))
    random = np.random.default_rng(1)

    def pose_at(t):
        wrong = [(Pose(math.nan, 0, 0), COVARIANCE), (Pose(9.0, 9.0, 1.0), -COVARIANCE)]
        return wrong[round(20 * t) % 3] if round(20 * t) % 3 < 2 else (Pose(1.0, 2.0, 0.5), COVARIANCE)

    world = World(lambda t: 0.0001 * random.normal(size=3), pose_at)
    detector = detect(world, pose="required")
    pose, covariance = detector.pose()
    assert pose == pytest.approx((1.0, 2.0, 0.5))
    assert np.array_equal(covariance, COVARIANCE)
    assert len(checked) <= 20 * world.monotonic() + 1


def test_poses_from_before_the_rover_stood_do_not_count():
    def pose_at(t):
        return (Pose(5.0, 0.0, 0.0), COVARIANCE) if t < 1.5 else None

    world = World(lambda t: (max(2.0 - t, 0.0), 0.0, 0.0), pose_at)
    with pytest.raises(NoPose):
        detect(world, pose="required", pose_wait_s=1.0)


def test_another_drivers_lease_is_named():
    world = World(lambda t: (0.0, 0.0, 0.0))
    world.gate = SimpleNamespace(lease=3, driver_name="a teleop")
    with pytest.raises(start.AnotherDriver, match="a teleop holds the lease"):
        detect(world)
