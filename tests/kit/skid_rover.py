"""Drives of a skid-steered rover by its kinematics, with errors that the estimator has states for."""

import math
from dataclasses import dataclass

import numpy as np

from deploy.estimator.estimator import Estimator
from kit.base_odometry import MOTION_CAPTURE, reported
from rover_ncp.core.geometry import Pose, Velocity, wrap_angle
from sim.world.random_course import random_course

TICK_S, PARTS = 0.1, 10
ACCEL = np.array([0.31, 1.25])


@dataclass(frozen=True)
class Camera:
    """External poses: each so many ticks, seconds late, standard deviations of x, y (m) and heading (rad)."""

    every: int = 2
    delay_s: float = 0.1
    sigma: tuple[float, float, float] = (0.02, 0.02, math.radians(1.0))

    @property
    def covariance(self):
        return np.diag(np.square(self.sigma))


class SkidDrive:
    """One drive over a random course, with errors drawn from the priors of ``settings``."""

    def __init__(self, settings, seed, number):
        rng = np.random.default_rng([seed, number])
        s = settings
        draw = lambda mean, std: mean + std * rng.normal()  # noqa: E731
        self.distance = draw(s.distance_gain, s.distance_gain_std)
        self.gain = draw(s.turn_gain, s.turn_gain_std)
        self.pull = draw(s.wheel_mismatch_rad_m, s.wheel_mismatch_std_rad_m)
        self.center = draw(s.rotation_center_m, s.rotation_center_std_m)
        more = np.random.default_rng([seed, number, 1])
        self.left = s.rotation_center_left_m + s.rotation_center_left_std_m * more.normal()
        self.gyro_scale = 1.0 + s.gyro_scale_std * more.normal()
        self.bias_steps = s.gyro_bias_walk_rad_s * math.sqrt(TICK_S) * more.normal(size=10_000)
        self.drift = draw(0.0, 0.0005)
        self.bias = 0.1 * rng.normal()
        self.downhill = s.downhill_std_m * rng.normal(size=2)
        motion = np.array(random_course(seed, number)[1].motion)
        motion = motion[: np.flatnonzero(motion.any(axis=1))[-1] + 1]
        commands = np.pad(motion, ((10, 20), (0, 0)))  # it rests for 1 s before and for 2 s after
        self.ticks = len(commands)
        start = Pose(*(rng.normal(size=3) * [0.05, 0.05, 0.05]))
        h = TICK_S / PARTS
        x = np.array([*start, *rng.uniform(-3, 3, 3), 0.0, 0.0])
        self.states, self.turned = [x.copy()], [0.0]
        for command in commands:
            begin = x[2]
            for _ in range(PARTS):
                x[6:] += np.clip(command - x[6:], -ACCEL * h, ACCEL * h)
                x = self._moved(x, h, rng, s)
            self.states.append(x.copy())
            self.turned.append(x[2] - begin)
        self.rng = rng

    def _moved(self, x, h, rng, s):
        v, omega = x[6:]
        if v == omega == 0.0:
            creep = np.array([s.creep_m, s.creep_m, s.creep_rad]) * math.sqrt(h) * rng.normal(size=3)
            return x + np.array([*creep, 0.0, 0.0, h * self.drift, 0.0, 0.0])
        turn = self.gain * omega + self.pull * v
        ahead, left = self.distance * v + self.left * turn, self.center * turn
        length, angle = abs(self.distance * v) * h, abs(turn) * h
        self.gain += s.turn_gain_walk * math.sqrt(angle) * rng.normal()
        self.center += 0.003 * math.sqrt(angle) * rng.normal()
        heading, own = x[2] + 0.5 * h * turn, x[5] + 0.5 * h * omega
        spread = math.sqrt(s.wander_m**2 * length + s.skid_m**2 * angle)
        slide = angle * self.downhill + spread * rng.normal(size=2)
        cos, sin = math.cos(heading), math.sin(heading)
        way = h * np.array([ahead * cos - left * sin, ahead * sin + left * cos]) + slide
        angle = h * turn + math.sqrt(s.wander_rad**2 * length + s.skid_rad**2 * angle) * rng.normal()
        reported_way = h * v * math.cos(own), h * v * math.sin(own), h * (omega + self.drift)
        return x + np.array([*way, angle, *reported_way, 0.0, 0.0])

    def pose(self, tick):
        """The true pose, also between two ticks."""
        at = min(max(tick, 0.0), self.ticks)
        a = min(int(at), self.ticks - 1)
        x, y, theta = (a + 1 - at) * self.states[a][:3] + (at - a) * self.states[a + 1][:3]
        return Pose(x, y, wrap_angle(theta))

    def follow(self, camera=None, gyro=False, carried=None):
        """Run an estimator along the drive; return errors (ticks, 3), covariances (ticks, 3, 3), estimator.

        From tick ``carried[0]`` on, the rover is displaced by ``carried[1]``.
        """
        rng = self.rng
        estimator = Estimator()
        start, spread = self.states[0], (0.002, 0.002, 0.002)
        at = Pose(*(start[:3] + rng.normal(size=3) * spread))
        estimator.start(at, 0.0, self.report(0)[0], np.diag(np.square(spread)), MOTION_CAPTURE)
        coming, errors, covariances = [], [], []
        next_pose = rng.uniform(0.0, 0.2)
        self.stopped = None
        for tick in range(1, self.ticks + 1):
            t = tick * TICK_S
            if gyro:
                step = math.radians(0.954)
                self.bias += self.bias_steps[tick]
                rate = self.turned[tick] / TICK_S / self.gyro_scale + self.bias
                readings = [round(rate / step + 0.7 * rng.normal()) for _ in range(4)]
                estimator.gyro(step * np.mean(readings), t)
            estimator.odometry(*self.report(tick), t)
            while camera is not None and next_pose <= t:
                seen = np.array(self.pose(next_pose / TICK_S)) + rng.normal(size=3) * camera.sigma
                if carried is not None and tick > carried[0]:
                    seen += carried[1]
                coming.append((next_pose + camera.delay_s, Pose(*seen[:2], wrap_angle(seen[2]))))
                next_pose += camera.every * TICK_S
            while coming and coming[0][0] <= t:
                arrival, seen = coming.pop(0)
                # The stamps' clock is unknown: a delay that all poses have does not show.
                estimator.external(seen, camera.covariance, arrival)
            if estimator.fault and self.stopped is None:
                self.stopped = tick
            estimate = estimator.at(t)
            error = np.array(estimate.pose) - self.pose(tick)
            error[2] = wrap_angle(error[2])
            errors.append(error)
            covariances.append(estimate.covariance[:3, :3])
        return np.array(errors), np.array(covariances), estimator

    def report(self, tick):
        x, y, theta, v, omega = self.states[tick][3:]
        return reported(Pose(x, y, theta), Velocity(v, omega))
