"""A ROS 2 robot on a simulated rover: commands in, messages out, time passed in.

It moves as its description says. It publishes odometry and gyro at their rates, stamped by its own clock.
Without a command it halts after the description's timeout, or not at all. A command stamped longer ago than
that is ignored, as ros2_control's diff_drive_controller does.
"""

import math
import random
from collections import deque

import numpy as np

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, compose, wrap_angle
from rover_ncp.course.course import TICK_S
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire import messages
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.messages import TWIST_BYTES
from sim.base.faults import Faults
from sim.base.sensors import TurnMeter
from sim.base.simulated_base import SimulatedBase
from sim.base.trial import BaseTrial
from sim.world.rover import SUBSTEP_S, Rover

RESTART_S = 1.5
"""How long a robot that restarts is silent (chosen)."""
BATTERY_S = 1.0
"""Time between two reports of the battery."""
SWITCHES_HZ = 20.0
"""Rate of the stop button and of hazards (chosen)."""
GYRO_LATE_S = 0.02
"""How long a reading of the gyro takes at least (chosen): odometry overtakes it, as on many robots."""
BEAMS = 120
"""Beams of the mock's laser, 3 degrees apart."""


class Ros2Robot(SimulatedBase):
    """One robot, which has topics; ``epoch_s`` is its wall clock minus the clock of ``start_s``.

    Faults and the trial count from the first command that moves it.
    """

    def __init__(
        self,
        description: RobotDescription,
        rover: Rover,
        faults: Faults | None = None,
        start_s: float = 0.0,
        *,
        epoch_s: float = 0.0,
        trial: BaseTrial | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(description, rover, faults, start_s, trial)
        assert description.topics is not None
        self.topics = description.topics
        self._stop, self._hazards = (
            found.topic if found else None for found in (self.topics.stop, self.topics.hazards)
        )
        self.drive.enable(True)
        self._ignored = 0
        self._random, self._epoch_s = random.Random(seed), epoch_s
        self._fed_s = self._silent_until_s = -math.inf
        rates = {
            self.topics.odom: description.odometry.rate_hz,
            self.topics.imu: description.gyro.rate_hz if description.gyro else 0.0,
            self.topics.battery_state: 1.0 / BATTERY_S,
            self._stop: SWITCHES_HZ,
            self._hazards: SWITCHES_HZ,
            self.topics.scan: description.scan.rate_hz if description.scan else 0.0,
        }
        self._rates = {name: hz for name, hz in rates.items() if name is not None and hz}
        """How often it publishes each of its topics, by name."""
        self._due = dict.fromkeys(self._rates, start_s)
        spans = round(description.odometry.speed_mean_s * description.odometry.rate_hz)
        self._ways = deque([(start_s, 0.0, 0.0)], maxlen=spans + 1)
        """Times of the last reports, with the ways (m) of the left and the right wheel."""
        self._held: deque[tuple[float, bytes]] = deque()
        """Odometry that is sent late, and when."""
        self._readings: deque[tuple[float, bytes]] = deque()
        """Readings of the gyro under way, and when they arrive."""
        self._turns = TurnMeter(rover, start_s)
        self._out: list[tuple[str, bytes]] = []
        self._frozen: Pose | None = None

    @property
    def ignored(self) -> int:
        """Number of commands that could not be read, or were late, not finite or of the other type."""
        return self._ignored

    @property
    def due_s(self) -> float:
        """The end of the substep in which it next publishes odometry; all else may wait for that."""
        next_s = min(self._due[self.topics.odom], self._held[0][0] if self._held else math.inf)
        substeps = math.ceil((next_s - self._start_s) / SUBSTEP_S - 1e-6)
        return self._start_s + max(substeps, self._substeps + 1) * SUBSTEP_S

    def command(self, payload: bytes, now: float) -> None:
        """Take a message of its ``cmd_vel``."""
        self.advance(now)
        if self._fault("deaf") is not None or self._trial.lost or self.now < self._silent_until_s:
            return
        stamped = self.topics.cmd_vel_type == "TwistStamped"
        try:
            velocity, stamp_ns = messages.read_twist(self._faults.damage(payload, self._driven_s))
        except FormatError:
            self._ignored += 1
            return
        timeout_s = self.topics.cmd_vel_timeout_s
        late = (
            stamp_ns is not None and timeout_s is not None and self._stamp_ns() - stamp_ns > timeout_s * 1e9
        )
        finite = all(map(math.isfinite, velocity))
        if stamped != (len(payload) > TWIST_BYTES) or late or not finite:
            self._ignored += 1
            return
        if self._first_s is None and any(velocity):
            self._first_s = self.now
        self._fed_s = self.now
        self.drive.set_speed(velocity.v)
        self.drive.set_turn(velocity.omega)

    def messages(self) -> list[tuple[str, bytes]]:
        """Return the messages since the last call, with their topics."""
        sent, self._out = self._out, []
        return sent

    def _stamp_ns(self) -> int:
        return round((self.now + self._epoch_s + (self._fault("clock") or 0.0)) * 1e9)

    def _substep(self) -> None:
        if self._reset_begins():
            self.drive.stop()
            self.drive.zero_odometry()
            self._silent_until_s = self.now + RESTART_S
        if self._driven_s is not None:
            tick = int(self._driven_s / TICK_S + 1e-9)
            if tick > self._trial.tick:
                self._begin_tick(tick)
        timeout_s = self.topics.cmd_vel_timeout_s
        if timeout_s is not None and self.now - self._fed_s > timeout_s:
            self.drive.stop()
        self.drive.substep(halted=any(self._fault(name) is not None for name in ("stall", "stop-button")))
        self._substeps += 1
        if self.observe:
            self.observe(self.now)
        self._report()

    def _report(self) -> None:
        now, topics = self.now, self.topics
        due = {name for name, due_s in self._due.items() if now >= due_s - 1e-9}
        for name in due:
            self._due[name] = max(self._due[name] + 1.0 / self._rates[name], now)
        if self._fault("mute") is not None or now < self._silent_until_s:
            self._held.clear()
            self._readings.clear()
            return
        while self._held and now >= self._held[0][0] - 1e-9:
            self._emit(topics.odom, self._held.popleft()[1])
        if topics.imu in due:
            self._readings.append((now + GYRO_LATE_S, self._gyro()))
        while topics.imu and self._readings and now >= self._readings[0][0] - 1e-9:
            self._emit(topics.imu, self._readings.popleft()[1])
        if topics.battery_state in due:
            low = self._fault("low-battery")
            volts = self.robot.battery.nominal_v if low is None else low
            self._emit(topics.battery_state, messages.battery_state(volts, self._stamp_ns()))
        if self._stop in due:
            self._emit(self._stop, encode(messages.BOOL, data=self._fault("stop-button") is not None))
        if self._hazards in due:
            kinds = {"bumper": messages.BUMP, "stall": messages.STALL}
            found = [kind for fault, kind in kinds.items() if self._fault(fault) is not None]
            self._emit(self._hazards, messages.hazards(found, self._stamp_ns()))
        if topics.scan in due:
            self._emit(topics.scan, self._scan())
        if topics.odom in due:
            self._send_odometry()

    def _send_odometry(self) -> None:
        """Publish odometry, or hold it back for as long as a trial's messages take."""
        frames = self.topics.odom_frame, self.topics.base_frame
        data = messages.odometry(self._pose(), self._motion(), self._stamp_ns(), frames=frames)
        age_s = self._trial.next_age_s
        if age_s or self._held:
            self._held.append((max(self.now + age_s, self._held[-1][0] if self._held else 0.0), data))
        else:
            self._emit(self.topics.odom, data)

    def _gyro(self) -> bytes:
        assert self.robot.gyro is not None
        noise_rad_s = self.robot.gyro.noise_rad_s
        rate = self._turns.rate(self.now) + (self._fault("gyro") or 0.0)
        return messages.imu(rate + self._random.gauss(0.0, noise_rad_s), noise_rad_s**2, self._stamp_ns())

    def _scan(self) -> bytes:
        laser = self.robot.scan
        assert laser is not None
        rover = self.drive.rover
        mount = compose(rover.pose, Pose(laser.x_m, laser.y_m, math.radians(laser.yaw_deg)))
        beams = [compose(mount, Pose(0.0, 0.0, math.tau * beam / BEAMS)) for beam in range(BEAMS)]
        found = [rover.range_along(beam, laser.range_m[1]) for beam in beams]
        ranges = np.array([math.inf if range_m is None else range_m for range_m in found])
        return messages.laser_scan(ranges, laser.range_m, self._stamp_ns())

    def _pose(self) -> Pose:
        """Return the pose that it reports: the encoders', with the errors of trial and faults."""
        if self._fault("freeze-odometry") is None:
            self._frozen = None
        elif self._frozen is not None:
            return self._frozen
        (x, y, theta), noise, gauss = self.drive.odometry, self._trial.noise, self._random.gauss
        own = self.robot.odometry if self.drive.rover.moving else None
        spread_m, spread_rad = (own.noise_m, own.noise_rad) if own else (0.0, 0.0)
        x += noise.x + gauss(0.0, spread_m) + (self._fault("jump-odometry") or 0.0)
        y += noise.y + gauss(0.0, spread_m)
        theta += noise.theta + gauss(0.0, spread_rad)
        if step_rad := self.robot.odometry.heading_step_rad:
            theta = step_rad * round(theta / step_rad)
        pose = Pose(x, y, wrap_angle(theta))
        if self._fault("freeze-odometry") is not None:
            self._frozen = pose
        return pose

    def _motion(self) -> Velocity:
        """Return the motion that it reports: that of the moment, or its mean over some reports."""
        self._ways.append((self.now, *self.drive.wheels_m))
        (began_s, *began_m), (now_s, *now_m) = self._ways[0], self._ways[-1]
        if len(self._ways) < 2 or now_s <= began_s:
            return self.drive.measured
        left, right = ((way - before) / (now_s - began_s) for way, before in zip(now_m, began_m, strict=True))
        return Velocity((left + right) / 2.0, (right - left) / (2.0 * self.robot.half_track_m))

    def _emit(self, topic: str, payload: bytes) -> None:
        self._out.append((topic, self._faults.damage(payload, self._driven_s)))
