"""The steps of a check before anything moves: link, odometry, sensors, battery, hazards."""

import math
from importlib.metadata import version

from deploy import comparisons
from deploy.check_moves import Moves
from deploy.comparisons import Answer, Samples
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.zenoh_link import ROUND_TRIP_S, ZenohLink
from deploy.publishers import Publishers
from rover_ncp.core.clock_offset import NS_PER_S
from rover_ncp.core.errors import FormatError
from rover_ncp.core.process import Clock
from rover_ncp.recording.recording import Recorded
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.cdr import decode
from rover_ncp.wire.protocol import in_words

RATE_HZ, LISTEN_S = 8.0, 2.0
"""A base reports ten times a second; with fewer than eight, packets are lost."""
ATTEMPTS = 2
"""A second attempt, because a stall of this computer is no fault of the robot."""
RATE_SHARE, MAX_HZ = 0.8, 50.0
"""Share of a described rate; a bridge passes on 50 reports a second at most."""
BATTERY_SHARE, BATTERY_WAIT_S = 11.5 / 11.0, 2.0
"""Of the voltage at which the gate stops, so that a drive ends before it; a Pioneer's alarm level."""
CLOCK_WAIT_S = 8.0
"""A bridge that has just begun knows a clock's rate after 7 s of odometry."""
NO_REPLY = "the bridge does not report its base"


class Battery:
    """The newest battery voltage (V) among the link's messages: 0 if it is not known, NaN without one."""

    voltage = math.nan

    def record(self, message: Recorded) -> None:
        """Read a message, as the link's recorder."""
        if message.topic == "battery_state":
            try:
                volts = decode(message.type, message.data).voltage
                self.voltage = volts if math.isfinite(volts) else 0.0
            except FormatError:
                self.voltage = math.nan


class InputSteps:
    """What arrives from one robot that stands; ``rest`` has the samples of that time."""

    def __init__(
        self,
        link: ZenohLink,
        measurements: Measurements,
        monitor: SafetyMonitor,
        moves: Moves,
        battery: Battery,
        *,
        publishers: Publishers,
        robot: RobotDescription | None,
        clock: Clock,
    ) -> None:
        self._link, self._measurements, self._monitor = link, measurements, monitor
        self._moves, self._battery, self._publishers = moves, battery, publishers
        self._robot, self._clock = robot, clock
        self.rest = Samples()

    def link(self) -> Answer:
        """Measure round trip and clock offset, and compare the versions at both ends."""
        base, round_trip_s, ahead_s = None, math.inf, 0.0
        for _ in range(ATTEMPTS):
            began_s, wall_ns = self._clock.monotonic(), self._clock.time_ns()
            base = self._link.about_base()
            took_s = self._clock.monotonic() - began_s
            if base is not None and took_s < round_trip_s:
                round_trip_s, ahead_s = took_s, (base.wall_ns - wall_ns) / NS_PER_S - 0.5 * took_s
        if base is None:
            return False, NO_REPLY
        zenoh = version("eclipse-zenoh")
        words = (
            f"the bridge answers in {1000 * round_trip_s:.0f} ms (at most {1000 * ROUND_TRIP_S:.0f} ms); "
            f"its clock is {ahead_s:+.2f} s from this one's (a drive may have any); "
            f"rover-ncp {base.version} and Zenoh {base.zenoh} there, {version('rover-ncp')} and {zenoh} here"
        )
        if base.zenoh.partition(".")[0] != zenoh.partition(".")[0]:
            return False, f"{words}: expected the same version of Zenoh"
        return round_trip_s <= ROUND_TRIP_S, words

    def odometry(self) -> Answer:
        """Check the rate of odometry, and that each input has one publisher."""
        ok, words = self._rate()
        problems = list(self._publishers.problems(self._link.namespace))
        keep_out = "keep others out with 'rover-ncp keys'"
        return (False, f"{'; '.join(problems)}: {keep_out}") if ok and problems else (ok, words)

    def _rate(self) -> Answer:
        minimum, rate = RATE_HZ, 0.0
        if self._robot is not None:
            minimum = RATE_SHARE * min(self._robot.odometry.rate_hz, MAX_HZ)
        for _ in range(ATTEMPTS):
            before = self._measurements.taken["odom"]
            self.rest = self._moves.listen(LISTEN_S)
            rate = (self._measurements.taken["odom"] - before) / LISTEN_S
            if rate >= minimum:
                break
        words = f"{rate:.1f} reports a second (at least {minimum:g})"
        if rate == 0.0:
            words = f"{words}: {self._monitor.why_no_odometry()}"
        return rate >= minimum, words

    def clock(self) -> Answer | None:
        """Check that the robot's clock runs as fast as the bridge's, which needs some seconds of odometry."""

        def known() -> bool:
            base = self._link.about_base()
            return base is None or base.clock is not None

        self._moves.until(known, CLOCK_WAIT_S)
        base = self._link.about_base()
        return None if base is None or not base.clock else (False, base.clock)

    def unheard(self) -> Answer | None:
        """Check that each input of the description has sent something."""
        base = self._link.about_base()
        return None if base is None or not base.unheard else (False, "; ".join(base.unheard))

    def gyro(self) -> Answer | None:
        """Check a gyro while the robot stands."""
        if complaint := self._measurements.complaints.get("imu"):
            return False, f"its messages cannot be read: {complaint}"
        if not self.rest.gyro and self._measurements.taken["imu"]:
            return False, "the rates of its readings are not finite"
        topics = self._robot.topics if self._robot is not None else None
        if self.rest.gyro or (topics is not None and topics.imu is not None):
            return comparisons.gyro_at_rest(self.rest)
        return None

    def poses(self) -> Answer | None:
        """Check rate, age and frame of external poses."""
        if complaint := self._measurements.complaints.get("pose"):
            return False, f"messages on pose cannot be read: {complaint}"
        if not self.rest.poses:
            elsewhere = self._publishers.elsewhere("pose", self._link.namespace)
            named = ", ".join(where or "no namespace" for where in elsewhere)
            words = (
                f"none arrives{self._link.where}, but some do in: {named} (expected only for another robot)"
            )
            return (True, words) if elsewhere else None
        return comparisons.poses_at_rest(self.rest, self._moves.pose_frames, min(self._moves.pose_ages_s))

    def battery(self) -> Answer:
        """Check the voltage."""
        base = self._link.about_base()
        if base is None:
            return False, NO_REPLY
        minimum = BATTERY_SHARE * (base.battery_min_v or 0.0)
        self._moves.until(lambda: math.isfinite(self._battery.voltage), BATTERY_WAIT_S)
        volts, most = self._battery.voltage, math.inf
        if math.isnan(volts):
            return False, f"no battery_state arrived within {BATTERY_WAIT_S:g} s, expected one a second"
        if volts <= 0.0:  # as to the gate
            return True, "the base reports no voltage: a low battery would stop nothing"
        words = f"{volts:.3g} V (at least {minimum:.3g} V"
        if self._robot is not None:
            most = 2.0 * self._robot.battery.nominal_v
            words += f", at most {most:.3g} V"
        return minimum <= volts <= most, f"{words})"

    def holds(self) -> Answer:
        """Check that hazards are reported, and that none holds the robot."""
        base, gate = self._link.about_base(), self._link.gate
        if base is not None and base.problem:
            return False, f"the bridge reports that {base.problem}"
        holder = gate.driver_name or ("a driver without a name" if gate.lease else gate.held)
        if holder:
            return False, f"held by {in_words(holder)}"
        topics = self._robot.topics if self._robot is not None else None
        absent = [] if topics is None else [name for name in ("stop", "hazards") if not getattr(topics, name)]
        named = ", ".join(f"topics.{name}" for name in absent)
        unknown = f"; the description names no {named}: what such a topic reports would stop nothing"
        return True, f"nothing holds the rover{unknown if absent else ''}"
