"""Injections of the hazard table into what a driver receives and sends: peers, charges, commands, poses.

Each is a function of the drive that it changes, as those of `kit.hazard_injections`.
"""

from collections import deque

import numpy as np

from bridge.ros2.inputs import DockedReports
from deploy.place.outcome import Stage
from kit.virtual_drive import LOST
from rover_ncp.core.geometry import STANDSTILL, Pose
from rover_ncp.wire import messages as ros
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.message_parts import header_of
from rover_ncp.wire.protocol import CommandTag, Signed, StopRequest, dump_json

NS = 10**9


def from_peer(name, content):
    """Let a peer send ``content(drive)`` after each of the bridge's and after each sample of odometry."""

    def inject(drive):
        link, receive = drive.link, drive.link._receive

        def received(topic, data):
            receive(topic, data)
            if topic in {"odom", name} and drive.active:
                link.put_from("peer", name, content(drive))

        link.bridge.deliver = received

    return inject


def false_charge(drive):
    """Return a new report of the battery each time."""
    drive.times += 1
    return ros.battery_state(12.5, drive.times * NS, charging=True)


def ended(reason):
    """Let a peer say in the gate's place that the lease has ended."""

    def status(drive):
        fields = {"lease": 0, "held": reason, "ended": reason}
        return ros.text(dump_json(drive.link.gate.model_copy(update=fields)).decode())

    return from_peer("rover/gate", status)


def charge(charging, *, old=False):
    """Let the base report a charge: ``charging(seconds of waiting for it)``, None before that."""

    def inject(drive):
        waits, stamps, statuses = [], [], drive.link.statuses

        def battery(data):
            now_s, state = drive.bridge.monotonic(), statuses[-1].state if statuses else ""
            waits.extend([now_s] if state.startswith(Stage.WAIT_FOR_CHARGE) and not waits else [])
            stamps.append(ros.read_battery(data).stamp_ns)
            found = charging(now_s - waits[0] if waits else None)
            return ros.battery_state(12.5, stamps[0 if old else -1], charging=found)

        drive.link.change["battery_state"] = battery

    return inject


def docked(said, *, old=False):
    """Let a topic of the robot say that it is docked: ``said(seconds of waiting for it)``, None before that.

    With ``old`` all messages have one stamp.
    """

    def inject(drive):
        waits, reports, statuses = [], DockedReports("is_docked"), drive.link.statuses

        def messages(odometry):
            now_s, state = drive.bridge.monotonic(), statuses[-1].state if statuses else ""
            waits.extend([now_s] if state.startswith(Stage.WAIT_FOR_CHARGE) and not waits else [])
            if not said(now_s - waits[0] if waits else None):
                return []
            header = header_of(NS if old else odometry.stamp_ns, "base_link")
            return [
                each.data
                for each in reports.take(encode(ros.DOCKED_TYPES["is_docked"], header=header, is_docked=True))
            ]

        drive.link.put_with_odometry("docked", messages)

    return inject


def on_command(tag):
    """Change the tags of the driver's commands: ``tag(drive, payload, sequence)``."""

    def inject(drive):
        drive.link.tag = lambda data, sequence: tag(drive, data, sequence) if drive.active else None

    return inject


def resigned(lease=0, age_s=0, number=None):
    def tag(drive, data, sequence):
        link = drive.link
        found = CommandTag(link.lease.number + lease, number or sequence, link.bridge.now_ns - age_s * NS)
        return found.sign(link.lease._secret, Signed.COMMAND, "cmd_vel", data)

    return tag


def lost_once(drive, data, sequence):
    drive.times += 1
    return LOST if drive.times == 1 else None


def forged(drive, data, sequence):
    drive.bridge.command(data, CommandTag(drive.link.lease.number, sequence + 5, drive.bridge.now_ns).pack())


def taken(drive):
    """Let another driver hold the lease."""
    request = b'{"enable": true, "name": "other"}'
    drive.link.request_motors = lambda name, ask=drive.link.request_motors: (
        drive.bridge.query("rover/motors", request),
        ask(name),
    )[1]


def stop_and_release(drive):
    def both():
        for request in (StopRequest(reason="a person"), StopRequest(release=True)):
            drive.bridge.query("rover/stop", dump_json(request))

    drive.then = both


def poses(see):
    """Let a localiser send ``see(drive, true pose)``, None for nothing, eight times a second."""

    def inject(drive):
        drive.localiser = see

    return inject


def far(drive, pose):
    return pose._replace(y=pose.y + 1.0)


def far_pose(drive):
    """Return a pose of a peer that is far from the rover's."""
    pose = far(drive, Pose(*drive.rover.pose))
    return ros.pose_with_covariance(pose, 1e-4 * np.eye(3), drive.bridge.time_ns(), "course")


def far_once(drive, pose):
    drive.times += 1
    return far(drive, pose) if drive.times == 1 else pose


def late(seconds):
    """Let the localiser's poses arrive so much later, with the stamps of their pictures."""

    def inject(drive):
        localise = drive.link.localise

        def later(data, arrival_ns):
            drive.held.append((arrival_ns, data))
            while drive.held and (not drive.active or drive.held[0][0] <= arrival_ns - seconds * NS):
                localise(drive.held.popleft()[1], arrival_ns)

        drive.link.localise = later

    return inject


def other_clock(seconds):
    """Let the localiser's clock be so much behind ours."""

    def inject(drive):
        localise = drive.link.localise

        def localised(data, arrival_ns):
            found = ros.read_pose(data)
            stamp_ns = found.stamp_ns - seconds * NS
            localise(
                ros.pose_with_covariance(found.pose, found.covariance, stamp_ns, found.frame), arrival_ns
            )

        drive.link.localise = localised

    return inject


def same(drive, pose):
    drive.held = drive.held or deque([pose])
    return drive.held[0]


DRIVER_INJECTIONS = {
    "charge unknown": charge(lambda waited_s: None),
    "charge only before the approach ends": charge(lambda waited_s: waited_s is None),
    "charge always": charge(lambda waited_s: True),
    "charge always before a wall": charge(lambda waited_s: True),
    "charge one report": charge(lambda waited_s: waited_s is not None and waited_s < 1.5),
    "charge an old report again and again": charge(lambda waited_s: True, old=True),
    "never says docked": docked(lambda waited_s: False),
    "docked only before the approach ends": docked(lambda waited_s: waited_s is None),
    "docked an old report again and again": docked(lambda waited_s: True, old=True),
    "docked one report": docked(lambda waited_s: waited_s is not None and waited_s < 0.15),
    "docked always": docked(lambda waited_s: True),
    "docked always before a wall": docked(lambda waited_s: True),
    "docked of a peer": from_peer("docked", lambda drive: ros.boolean(True)),
    "charge of a peer": from_peer("battery_state", false_charge),
    "odometry of a peer": from_peer(
        "odom", lambda drive: ros.odometry(Pose(9.0, 9.0, 1.0), STANDSTILL, drive.bridge.time_ns())
    ),
    "gyro of a peer": from_peer("imu", lambda drive: ros.imu(1.0, 1e-6, drive.bridge.time_ns())),
    "bumpers of a peer": from_peer("bumpers", lambda drive: ros.bumpers(True, True)),
    "low battery of a peer": from_peer(
        "battery_state", lambda drive: ros.battery_state(9.0, drive.bridge.time_ns())
    ),
    **{f"gate of a peer {reason}": ended(reason) for reason in ("bumper", "sonar", "low-battery")},
    "poses of a clock of an hour ago": other_clock(3600),
    "no poses": poses(lambda drive, pose: None),
    "late poses": late(1.5),
    "far pose once": poses(far_once),
    "far poses": poses(far),
    "far poses of a peer": from_peer("pose", far_pose),
    "poses of another heading": poses(lambda drive, pose: pose._replace(x=-pose.x, y=-pose.y)),
    "same pose": poses(same),
    "another driver": taken,
    "no commands arrive": on_command(lambda *_: LOST),
    "commands of 1 s ago": on_command(resigned(age_s=1)),
    "commands of another lease": on_command(resigned(lease=1)),
    "the same command again": on_command(resigned(number=1)),
    "one command is lost": on_command(lost_once),
    "forged commands": on_command(forged),
    "stop and release": stop_and_release,
}
