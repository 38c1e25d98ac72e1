"""A robot's Odometry messages as poses since it was connected. Pure.

A message counts when it is of the right frames, finite, new and fresh. Its age is the growth of (arrival −
stamp) over the minimum of the last minute, so that the robot's clock may be off by any constant.
"""

import math
from collections import deque
from typing import NamedTuple

from rover_ncp.core.clock_offset import remember
from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Pose, Velocity, distance, relative, wrap_angle
from rover_ncp.core.messages import OdometrySample, read_odometry
from rover_ncp.core.robot_description import Motion, Topics

RATE_S, LEAST_IN_RATE_S = 1.0, 5
"""At least so many messages must arrive in this time: the gate stops a rover whose odometry is 0.35 s old."""
BURST_S = 0.08
"""Messages closer than this count as one in that."""
STALE_S = 0.2
CLOCK_BACK_S = 1.0
"""Stamps that go back by more than this: the robot restarted, or its clock was set."""
JUMP_M = 0.05
"""A pose farther from the last one than the robot can drive, and this, has jumped."""
LATEST_NS = 2**31 * 1_000_000_000 - 1
"""The latest time that a ROS stamp can hold."""
ALTERNATIONS = 2
CONFLICT_S = 1.0


class Moved(NamedTuple):
    """Pose since the connection, heading not wrapped, and speeds; ``age_s`` is beyond the least transit."""

    pose: Pose
    velocity: Velocity
    age_s: float


class RosOdometer:
    """Reads one robot's odometry; ``problem`` is what was wrong with the last message if it did not count."""

    def __init__(self, topics: Topics, motion: Motion) -> None:
        self._topics, self._motion = topics, motion
        self.counters = dict.fromkeys(("messages", "unreadable", "stale", "repeated", "foreign"), 0)
        self.problem = ""
        self.restarts = 0
        """How often the origin was set anew, because the robot began again."""
        self._good_s = -math.inf
        self._spread: deque[float] = deque(maxlen=LEAST_IN_RATE_S)
        """When messages that count arrived, without those of a burst."""
        self._arrivals: deque[float] = deque(maxlen=64)
        self._sources: dict[bytes, float] = {}
        """The last two, the newest last, and when each last published."""
        self._minima: tuple[tuple[int, float], ...] = ()
        self._stamp_ns = 0
        self._seen: deque[tuple[float, Pose]] = deque(maxlen=2)
        self._alternations: deque[float] = deque(maxlen=ALTERNATIONS)
        self._clock_backs: deque[float] = deque(maxlen=ALTERNATIONS)
        self._origin: Pose | None = None
        self._theta = self._age_s = 0.0

    def take(self, payload: bytes, arrived_s: float, source: bytes | None = None) -> Moved | None:
        """Return the motion that a message reports; None if it does not count."""
        self.counters["messages"] += 1
        self._arrivals.append(arrived_s)
        try:
            sample = read_odometry(payload)
        except FormatError as error:
            self.counters["unreadable"] += 1
            self.problem = f"odometry cannot be read: {error}"
            return None
        if source is not None:
            self._sources.pop(source, None)
            self._sources[source] = arrived_s
            if len(self._sources) > 2:
                del self._sources[next(iter(self._sources))]
        wanted = self._topics.odom_frame, self._topics.base_frame
        frames = tuple(frame.rpartition("/")[2] for frame in (sample.frame, sample.child))
        if frames != wanted:
            self.problem = (
                f"odometry is of {sample.frame or '(none)'} → {sample.child or '(none)'}, expected "
                f"{wanted[0]} → {wanted[1]}: set topics.odom_frame and topics.base_frame in the description"
            )
            return None
        if not all(map(math.isfinite, (*sample.pose, *sample.velocity))):
            self.problem = "odometry is not finite"
            self._spread.clear()
            return None
        return self._moved(sample, arrived_s) if self._new_and_fresh(sample.stamp_ns, arrived_s) else None

    def reset(self) -> None:
        """Make the next pose the origin."""
        self._origin = None

    def enough(self, now: float) -> bool:
        """Whether messages that count arrive often enough."""
        return len(self._spread) == LEAST_IN_RATE_S and now - self._spread[0] <= RATE_S

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
        full = [found for found in (self._alternations, self._clock_backs) if len(found) == ALTERNATIONS]
        return max(known, 2 if any(now - found[0] < CONFLICT_S for found in full) else 1)

    def robot_clock_ns(self, now: float) -> int:
        """Return the present time on the robot's clock, at most a message's way behind; 0 if unknown.

        A message of another's may have moved that clock to the end of time: the result always fits a stamp.
        """
        if not self._minima:
            return 0
        return min(round((now - min(offset for _, offset in self._minima)) * 1e9), LATEST_NS)

    def _new_and_fresh(self, stamp_ns: int, arrived_s: float) -> bool:
        self._age_s = 0.0
        if stamp_ns == 0:  # a publisher without a clock
            return True
        if stamp_ns < self._stamp_ns - round(CLOCK_BACK_S * 1e9):
            self._clock_backs.append(arrived_s)
            self._minima, self._stamp_ns = (), 0
            self._restart()
        if stamp_ns <= self._stamp_ns:
            self.counters["repeated"] += 1
            return False
        self._stamp_ns = stamp_ns
        self._minima = remember(self._minima, arrived_s, stamp_ns)
        self._age_s = arrived_s - stamp_ns * 1e-9 - min(offset for _, offset in self._minima)
        if self._age_s > STALE_S:
            self.counters["stale"] += 1
            self.problem = f"odometry arrives {self._age_s:.1f} s late"
            return False
        return True

    def _moved(self, sample: OdometrySample, arrived_s: float) -> Moved:
        if self._seen and self.age_s(arrived_s) > CONFLICT_S and self._jumps(sample.pose, -1, arrived_s):
            self._restart()
        elif (
            len(self._seen) == 2
            and self._jumps(sample.pose, -1, arrived_s)
            # Back at the track of the message before the last: two robots report in turn.
            and not self._jumps(sample.pose, 0, arrived_s)
        ):
            self._alternations.append(arrived_s)
        self._good_s = arrived_s
        if not self._spread or arrived_s - self._spread[-1] >= BURST_S:
            self._spread.append(arrived_s)
        self.problem = ""
        last = self._seen[-1][1] if self._seen else sample.pose
        self._seen.append((arrived_s, sample.pose))
        if self._origin is None:
            self._origin, self._theta = sample.pose, 0.0
        else:
            self._theta += wrap_angle(sample.pose.theta - last.theta)
        x, y, _ = relative(self._origin, sample.pose)
        return Moved(Pose(x, y, self._theta), sample.velocity, self._age_s)

    def _jumps(self, pose: Pose, index: int, arrived_s: float) -> bool:
        at, before = self._seen[index]
        return distance(pose, before) > JUMP_M + 2.0 * self._motion.v_max * (arrived_s - at)

    def _restart(self) -> None:
        self.restarts += 1
        self._origin = None
        self._spread.clear()
        self._seen.clear()
