"""Injections of the hazard table: changed messages of a robot, and reports of a Pioneer.

Each is a function of the drive (`Cell` of ``tests/unit/test_hazards.py``) that it changes. It acts while the
drive is ``active``.
"""

import math
from collections import deque
from dataclasses import replace

from bridge.base import BaseReport
from bridge.inbox import RobotMessage
from kit.driver_injections import DRIVER_INJECTIONS
from rover_ncp.wire import messages as ros
from rover_ncp.wire.cdr import decode, encode
from sim.base.faults import Fault

NS = 10**9


def on_topic(name, change):
    """Change the messages of a topic of the ROS 2 robot: ``change(drive, payload)`` returns what arrives."""

    def inject(drive):
        robot, sent = drive.base, drive.base.messages

        def messages():
            for topic, payload in sent():
                if topic == name and drive.active:
                    yield from ((name, data) for data in change(drive, payload))
                else:
                    yield topic, payload

        robot.messages = messages

    return inject


def silence(drive, payload):
    return []


def once(change):
    """Apply a change to the first message alone."""

    def changed(drive, payload):
        drive.times += 1
        return change(drive, payload) if drive.times == 1 else [payload]

    return changed


def delay(seconds):
    """Let each message arrive so much later."""

    def delayed(drive, payload):
        drive.held.append((drive.bridge.now_ns, payload))
        due_ns = drive.bridge.now_ns - seconds * NS
        return [drive.held.popleft()[1] for _ in list(drive.held) if drive.held[0][0] <= due_ns]

    return delayed


def repeat(drive, payload):
    """Send the first message again and again."""
    drive.held = drive.held or deque([payload])
    return [drive.held[0]]


def odometry(change):
    """Change odometry: ``change(sample, first stamp)`` returns its pose, velocity and stamp."""

    def changed(drive, payload):
        sample = ros.read_odometry(payload)
        drive.first_ns = drive.first_ns or sample.stamp_ns
        frames = drive.robot.topics.odom_frame, drive.robot.topics.base_frame
        return [ros.odometry(*change(sample, drive.first_ns), frames=frames)]

    return changed


def as_stamped(stamp_ns):
    """Give odometry another stamp: ``stamp_ns(its own, the first one)``."""
    return odometry(
        lambda sample, first_ns: (sample.pose, sample.velocity, stamp_ns(sample.stamp_ns, first_ns))
    )


def as_pose(pose):
    """Give odometry another pose: ``pose(its own)``."""
    return odometry(lambda sample, first_ns: (pose(sample.pose), sample.velocity, sample.stamp_ns))


def second_publisher(name, payload):
    """Let a second publisher send ``payload`` after each message of the ROS 2 robot on a topic."""

    def inject(drive):
        connection, collect = drive.bridge.connection, drive.bridge.connection._collect

        def collected():
            before = len(connection.arrivals)
            collect()
            for own in connection.arrivals[before:]:
                if own.topic == name and drive.active:
                    connection.arrivals.append(RobotMessage(name, payload, own.arrived_s, b"other"))

        connection._collect = collected

    return inject


def rate(change):
    """Give the gyro another rate of turn: ``change(its own)``."""

    def changed(drive, payload):
        sample = ros.read_imu(payload)
        return [ros.imu(change(sample.rate), 1e-6, sample.stamp_ns)]

    return changed


def wall(drive, payload):
    message = decode(ros.LASER_SCAN, payload)
    stamp = message.header.stamp
    ranges = [0.25] * len(message.ranges)
    return [ros.laser_scan(ranges, (0.15, 12.0), stamp.sec * NS + stamp.nanosec)]


def pressed(value):
    return lambda drive, payload: [encode(ros.BOOL, data=value)]


def contacts(*kinds):
    return lambda drive, payload: [ros.hazards(kinds, drive.bridge.time_ns())]


def blocked(drive):
    """Let the wheels stand although the motors turn, and no bumper or stall be reported."""
    on_topic("hazard_detection", contacts())(drive)
    fault("stall")(drive)


def two_lasers(drive, payload):
    """Let a second laser, which sees nothing, report after the one that sees a wall."""
    message = decode(ros.LASER_SCAN, payload)
    stamp_ns = message.header.stamp.sec * NS + message.header.stamp.nanosec
    free = ros.laser_scan([math.inf] * len(message.ranges), (0.15, 12.0), stamp_ns)
    return [*wall(drive, payload), free]


def on_report(**fields):
    """Change fields of the Pioneer's reports; ``once`` is how many."""
    count = fields.pop("once", math.inf)

    def inject(drive):
        base, receive = drive.bridge.connection.base, drive.bridge.connection.base.receive

        def received(arrival, now):
            return [changed(event) for event in receive(arrival, now)]

        def changed(event):
            if not (isinstance(event, BaseReport) and drive.active and drive.times < count):
                return event
            drive.times += 1
            return replace(event, **fields)

        base.receive = received

    return inject


def late_packets(seconds):
    """Let all that a Pioneer sends arrive so much later."""

    def inject(drive):
        connection = drive.bridge.connection
        collect, held = connection._collect, deque()

        def collected():
            before = len(connection.arrivals)
            collect()
            now_s = connection._now
            held.extend((now_s, arrival) for arrival in connection.arrivals[before:])
            del connection.arrivals[before:]
            while held and (not drive.active or held[0][0] <= now_s - seconds):
                connection.arrivals.append(held.popleft()[1])

        connection._collect = collected

    return inject


def fault(name, value=0.0):
    """Inject a fault of the mock."""

    def inject(drive):
        drive.then = lambda: drive.base.inject(Fault(name, value))

    return inject


TOPICS = ("odom", "imu", "stop", "hazard_detection", "scan", "battery_state")
INJECTIONS = {
    **{f"silence {topic}": on_topic(topic, silence) for topic in TOPICS},
    **{f"truncate {topic} once": on_topic(topic, once(lambda _, data: [data[:-9]])) for topic in TOPICS},
    **{f"repeat {topic}": on_topic(topic, repeat) for topic in TOPICS},
    "delay odom 0.6": on_topic("odom", delay(0.6)),
    "delay imu 1.0": on_topic("imu", delay(1.0)),
    "delay stop 1.0": on_topic("stop", delay(1.0)),
    "delay hazard_detection 1.0": on_topic("hazard_detection", delay(1.0)),
    "delay scan 2.0": on_topic("scan", delay(2.0)),
    "delay battery_state 10": on_topic("battery_state", delay(10.0)),
    "freeze pose": fault("freeze-odometry"),
    "pose jumps once": on_topic("odom", once(as_pose(lambda pose: pose._replace(x=pose.x + 0.5)))),
    "pose NaN once": on_topic("odom", once(as_pose(lambda pose: pose._replace(x=math.nan)))),
    "pose NaN": on_topic("odom", as_pose(lambda pose: pose._replace(x=math.nan))),
    "gyro stuck": on_topic("imu", rate(lambda own: 0.0)),
    "gyro mirrored": on_topic("imu", rate(lambda own: -own)),
    "gyro in degrees": on_topic("imu", rate(math.degrees)),
    "gyro turns": on_topic("imu", rate(lambda own: 1.0)),
    "gyro NaN": on_topic("imu", rate(lambda own: math.nan)),
    "gyro turns once": on_topic("imu", once(rate(lambda own: 20.0))),
    "press stop": on_topic("stop", pressed(True)),
    "press stop every second time": on_topic(
        "stop", lambda d, p: [pressed(v)(d, p)[0] for v in (True, False)]
    ),
    "press stop once more": on_topic("stop", once(lambda d, p: [*pressed(True)(d, p), p])),
    "another publisher says that stop is released": second_publisher("stop", encode(ros.BOOL, data=False)),
    "contact": on_topic("hazard_detection", contacts(ros.BUMP)),
    "contact once": on_topic("hazard_detection", once(contacts(ros.BUMP))),
    "wheels dropped": on_topic("hazard_detection", contacts(ros.WHEEL_DROP)),
    "wheels blocked without contact": blocked,
    "wall by the scan alone": on_topic("scan", wall),
    "another laser does not see the wall": on_topic("scan", two_lasers),
    "stamps 0": on_topic("odom", as_stamped(lambda own, first: 0)),
    "stamps stand still": on_topic("odom", as_stamped(lambda own, first: first)),
    "slow clock": on_topic("odom", as_stamped(lambda own, first: (first + own) // 2)),
    "stamp of tomorrow once": on_topic("odom", once(as_stamped(lambda own, first: own + 86_400 * NS))),
    "clock of an hour ago": fault("clock", -3600.0),
    "no echoes": on_report(clear_ahead_m=math.nan, clear_behind_m=math.nan),
    "near echo": on_report(clear_ahead_m=0.1),
    "near echo once": on_report(clear_ahead_m=0.1, once=1),
    "packets 0.6 s late": late_packets(0.6),
    "pressed bumper before no echo": on_report(clear_ahead_m=5.0, bumpers=(1, 0)),
    "no voltage": on_report(battery_v=0.0),
    "low voltage": on_report(battery_v=10.0),
    "low voltage once": on_report(battery_v=10.0, once=1),
    "low voltage while it charges": on_report(battery_v=10.0, charging=True),
    "voltage NaN": on_report(battery_v=math.nan),
    **DRIVER_INJECTIONS,
}
