"""A robot's Odometry messages as poses since it was connected. Pure.

A message counts when it is of the right frames, finite, new and fresh, and its pose is where the robot can
have driven since the last one. Two poses in a row that are not begin odometry anew. The robot's clock may be
off by any constant, and may be set (`rover_ncp.core.clock_offset`).
"""

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from rover_ncp.core.clock_offset import StampClock, update_clock_offset
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import (
    Pose,
    Velocity,
    distance,
    relative,
    same_frame,
    wrap_angle,
)
from rover_ncp.robot.description import Motion
from rover_ncp.robot.topics import Topics
from rover_ncp.wire.messages import OdometrySample, read_odometry

RATE_S, MIN_IN_RATE = 1.0, 5
"""At least so many messages must arrive in this time: the gate stops a rover whose odometry is 0.35 s old."""
BURST_S = 0.08
"""Messages closer than this count as one in that."""
STALE_S = 0.2
LOSS_S = 0.5
"""Without odometry for longer than this, the base is lost and the robot gets zeros."""
CLOCK_BACK_S = 1.25
"""A clock that is set back by more than this may be that of a robot that restarted."""
JUMP_M, JUMP_RAD = 0.05, 0.1
"""A pose farther from the last one than a robot twice as fast can drive, and this, has jumped."""
MAX_NAME = 60
"""Longest frame name in a message."""
OTHER_RATE = 0.02
"""Clocks of computers differ by far less than this in a second."""
LATE_SECONDS, NOTICE_SECONDS = 2, 5
"""A clock's rate is named if it is another in each of so many seconds: when odometry is late, or alone."""
ALTERNATIONS, CONFLICT_S = 2, 1.0
"""So many jumps of pose or clock within this time, with others between, show a second publisher."""


class Moved(NamedTuple):
    """Pose since the connection, heading not wrapped, and speeds; ``age_s`` is beyond the least transit."""

    pose: Pose
    velocity: Velocity
    age_s: float


class RosOdometer:
    """Reads one robot's odometry; ``problem`` is what was wrong with the last message if it did not count.

    ``where`` is the topic's full name.
    """

    def __init__(self, topics: Topics, motion: Motion, where: str) -> None:
        self._topics, self._motion, self._where = topics, motion, where
        self.counters = dict.fromkeys(("messages", "stale", "repeated", "jumped", "foreign"), 0)
        self.problem = ""
        self.notices: list[str] = []
        """Lines for the log that the last message gave cause for."""
        self._unnamed = self._other_rate = False
        """Whether the log names an empty frame, and a clock that runs at another rate."""
        self.clock: str | None = None
        """How the clock of odometry runs at another rate; "" if it does not, None = not known yet."""
        self.restarts = 0
        """How often the origin was set anew, because the robot began again, and why the last time."""
        self.restart_reason = ""
        self._good_s = -math.inf
        self._spread: deque[float] = deque(maxlen=MIN_IN_RATE)
        """When messages that count arrived, without those of a burst."""
        self._arrivals: deque[float] = deque(maxlen=64)
        self._sources: dict[bytes, float] = {}
        """The last two, the newest last, and when each last published."""
        self._clock = StampClock()
        self._stamp_ns = 0
        self._offsets: tuple[tuple[int, float], ...] = ()
        """Seconds of arrival, and the smallest (arrival − stamp) in each, whether it counts or not."""
        self._last: tuple[float, OdometrySample] | None = None
        """The last message that counts, and when it arrived."""
        self._jumped = False
        """Whether the pose of the newest message jumped."""
        self._conflicts: deque[float] = deque(maxlen=ALTERNATIONS)
        """When messages arrived whose pose or clock jumped."""
        self._origin: Pose | None = None
        self._theta = self._age_s = 0.0

    def take(self, payload: bytes, arrived_s: float, source: bytes | None = None) -> Moved | None:
        """Return the motion that a message reports; None if it does not count."""
        self.counters["messages"] += 1
        self.notices = []
        self._arrivals.append(arrived_s)
        try:
            sample = read_odometry(payload)
        except FormatError as error:
            self.problem = f"odometry cannot be read: {error}"
            return None
        if source is not None:
            self._sources.pop(source, None)
            self._sources[source] = arrived_s
            if len(self._sources) > 2:
                del self._sources[next(iter(self._sources))]
        expected = self._topics.odom_frame, self._topics.base_frame
        if not all(map(same_frame, (sample.frame, sample.child), expected)):
            names = [f"{name[:MAX_NAME] or '(none)'}" for name in (sample.frame, sample.child, *expected)]
            self.problem = (
                f"odometry is of {names[0]} → {names[1]}, expected {names[2]} → {names[3]}: "
                "set topics.odom_frame and topics.base_frame in the description"
            )
            return None
        if not (sample.frame and sample.child) and not self._unnamed:
            self._unnamed = True
            frames = f"{expected[0] or 'odom'} → {expected[1] or 'base_link'}"
            self.notices.append(f"odometry on {self._where} leaves a frame empty: it is taken for {frames}")
        if not all(map(math.isfinite, (*sample.pose, *sample.velocity))):
            self.problem = "odometry is not finite"
            self._spread.clear()
            return None
        if not self._new_and_fresh(sample.stamp_ns, arrived_s):
            return None
        return self._moved(sample, arrived_s)

    def enough(self, now: float) -> bool:
        """Whether messages that count arrive often enough."""
        return len(self._spread) == MIN_IN_RATE and now - self._spread[0] <= RATE_S

    def count_anew(self) -> None:
        """Let only messages from now on be `enough`."""
        self._spread.clear()

    def age_s(self, now: float) -> float:
        """Return the time since the last message that counted."""
        return now - self._good_s

    def rate_hz(self, now: float) -> float:
        """Return how many messages arrived per second in the last 3 s, whether they count or not."""
        recent = [at for at in self._arrivals if now - at <= 3.0]
        return len(recent) / 3.0

    def publishers(self, now: float) -> int:
        """Return how many publishers the messages of the last second show, 2 for any more."""
        known = sum(now - at < CONFLICT_S for at in self._sources.values())
        alternate = len(self._conflicts) == ALTERNATIONS and now - self._conflicts[0] < CONFLICT_S
        return max(known, 2 if alternate else 1)

    def robot_clock_ns(self, now: float) -> int:
        """Return the present time on the robot's clock, at most a message's way behind; 0 if unknown."""
        return self._clock.sender_ns(round(now * 1e9)) or 0

    def _new_and_fresh(self, stamp_ns: int, arrived_s: float) -> bool:
        self._age_s = 0.0
        if stamp_ns == 0:  # a publisher without a clock
            self.clock = ""
            return True
        arrived_ns = round(arrived_s * 1e9)
        self._offsets = update_clock_offset(self._offsets, arrived_s, stamp_ns)
        seconds = self._offsets[-NOTICE_SECONDS - 2 : -1]  # the second of now is not over
        if len(seconds) > NOTICE_SECONDS:
            rate, speeds = _clock_rate(seconds), "it then drives at other speeds than it is sent"
            self.clock = f"odometry on {self._where}: {rate}; {speeds}" if rate else ""
        if self.clock and not self._other_rate:
            self._other_rate = True
            self.notices.append(self.clock)
        measured_ns = self._clock.measured_ns(stamp_ns, arrived_ns)
        back_s = self._clock.set_back_s
        if back_s:
            self._stamp_ns = 0
        if back_s > CLOCK_BACK_S:
            self._restart(f"its clock was set back by {back_s:.2f} s")
        elif back_s:
            self.notices.append(f"the clock that stamps {self._where} was set back by {back_s:.2f} s")
        if self._clock.doubt_s > CLOCK_BACK_S:
            self._conflicts.append(arrived_s)
        if measured_ns is None:
            self.counters["stale"] += 1
            self.problem = f"the stamps of odometry jump by {self._clock.doubt_s:.1f} s"
            return False
        if stamp_ns <= self._stamp_ns:
            self.counters["repeated"] += 1
            self.problem = "the stamps of odometry stand still or go back"
            return False
        self._stamp_ns = stamp_ns
        self._age_s = (arrived_ns - measured_ns) * 1e-9
        if self._age_s > STALE_S:
            self.counters["stale"] += 1
            rate = _clock_rate(self._offsets[-LATE_SECONDS - 1 :])
            self.problem = f"odometry arrives {self._age_s:.1f} s late" + (f": {rate}" if rate else "")
            return False
        return True

    def _moved(self, sample: OdometrySample, arrived_s: float) -> Moved | None:
        again, self._jumped = self._jumped, self._jumps(sample.pose, arrived_s)
        if self._jumped and not again:
            self.counters["jumped"] += 1
            self._conflicts.append(arrived_s)
            self.problem = "its pose jumped"
            return None
        if self._jumped:
            self._restart("its pose jumped, so the robot restarted or was moved")
        self._good_s = arrived_s
        if not self._spread or arrived_s - self._spread[-1] >= BURST_S:
            self._spread.append(arrived_s)
        self.problem = ""
        if self._origin is None or self._last is None:
            self._origin, self._theta = sample.pose, 0.0
        else:
            self._theta += wrap_angle(sample.pose.theta - self._last[1].pose.theta)
        self._last = arrived_s, sample
        x, y, _ = relative(self._origin, sample.pose)
        return Moved(Pose(x, y, self._theta), sample.velocity, self._age_s)

    def _jumps(self, pose: Pose, arrived_s: float) -> bool:
        """Return whether a pose is farther from the last one than the robot can have driven.

        A robot that was silent was sent zeros since then: it can only have coasted from its last speed.
        """
        if self._last is None:
            return False
        (at_s, last), motion = self._last, self._motion
        v, omega = map(abs, last.velocity)
        m, rad = v * v / (2.0 * motion.decel), omega * omega / (2.0 * motion.alpha_decel)
        seconds = LOSS_S
        if arrived_s - at_s <= LOSS_S:
            v, omega, m, rad = 2.0 * motion.v_max, 2.0 * motion.omega_max, 0.0, 0.0
            seconds = arrived_s - at_s
        moved, turned = distance(pose, last.pose), abs(wrap_angle(pose.theta - last.pose.theta))
        return moved > JUMP_M + m + v * seconds or turned > JUMP_RAD + rad + omega * seconds

    def _restart(self, reason: str) -> None:
        self.restarts += 1
        self.restart_reason = reason
        self._origin = None
        self._last, self._jumped = None, False
        self._spread.clear()


def _clock_rate(offsets: Sequence[tuple[int, float]]) -> str:
    """Return in words if a clock ran at another rate in each second, by its offsets; "" if not.

    A clock that is set differs in one second only.
    """
    rates = [1.0 - (after - before) / (to - since) for (since, before), (to, after) in pairwise(offsets)]
    fast, slow = (rate > 1.0 + OTHER_RATE for rate in rates), (rate < 1.0 - OTHER_RATE for rate in rates)
    if not rates or not (all(fast) or all(slow)):
        return ""
    mean = math.fsum(rates) / len(rates)
    simulated = f"as in a simulation that is {'faster' if mean > 1.0 else 'slower'} than real time"
    return f"its stamps advance by {mean:.2f} s in a second of this computer, {simulated}"
