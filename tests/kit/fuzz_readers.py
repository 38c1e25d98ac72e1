"""All readers of external data, with samples: each may return, or raise the package's own error.

Shared by ``test_fuzz_readers.py``, which runs a little of it everywhere, and ``fuzz_atheris.py``, which goes
on for as long as FUZZ_S says, guided by the code's own branches.
"""

import functools
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bridge.base import BaseReport, Setpoint
from bridge.gate.limits import Limits
from bridge.inbox import RobotMessage
from bridge.pioneer.framing import Command, Decoder, Packet, encode_command, encode_frame
from bridge.pioneer.packets import ConfigPac, GyroPac, Sip, decode_names, encode_names
from bridge.pioneer.session import Session
from bridge.ros2.address import parse_ros_address
from bridge.ros2.base import Ros2Base
from bridge.ros2.discovery import TokenSeen, read_topic_token, topic_token
from bridge.ros2.rmw import read_token
from deploy.drive.config import DriveConfig
from deploy.drive.records import CONFIG_FILE, attachments
from deploy.replay import TOPICS, replay
from deploy.view.recorded_drive import read_drive
from kit.described import described
from kit.ros2_world import Line
from kit.virtual_drive import VirtualDrive
from rover_ncp.circuit.policy_file import policy_from_yaml
from rover_ncp.core.config import dump_yaml, parse_yaml
from rover_ncp.core.errors import RoverNcpError
from rover_ncp.core.files import read_bytes, resolve, shipped_names
from rover_ncp.core.geometry import STANDSTILL, Pose
from rover_ncp.course.course import Course
from rover_ncp.recording.recording import RecordingWriter, header_stamp_ns, read_recording
from rover_ncp.robot.description import RobotDescription
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.wire import protocol as lease
from rover_ncp.wire.key_table import KEYS, Kind
from rover_ncp.wire.messages import (
    battery_state,
    decode,
    imu,
    laser_scan,
    neurons,
    odometry,
    read_neurons,
    read_odometry,
    read_pose,
    read_text,
    read_twist,
    text,
    twist_stamped,
)
from sim.base.client_commands import decode_argument
from sim.base.firmware import Firmware
from sim.world.described import default_rover
from sim.world.pymunk_rover import Ground, PymunkRover
from sim.world.randomization import Randomization

HERE = Pose(0.1, 0.2, 0.3)
JSON_MODELS = (
    lease.BaseReply,
    lease.BaseRequest,
    lease.DriverStatus,
    lease.GateStatus,
    lease.MotorsReply,
    lease.MotorsRequest,
    lease.StopReply,
    lease.StopRequest,
)
YAML_MODELS = (Course, DriveConfig, Limits, Randomization, RobotDescription, RoverProfile)


class Reader(NamedTuple):
    """``read`` takes any bytes; ``samples`` make the samples of what it is meant for."""

    read: Callable[[bytes], object]
    samples: Callable[[], Sequence[bytes]]


def survives(reader: Reader, data: bytes) -> None:
    """Let a reader read; what it raises is its own error, in one line, or the test's failure."""
    try:
        reader.read(data)
    except RoverNcpError as error:
        assert str(error).strip()
        assert "\n" not in str(error)


def _all_survive(data, *reads):
    for read in reads:
        survives(Reader(read, list), data)


# The base's line


def _line(data):
    half = len(data) // 2
    for packet in (decoder := Decoder()).feed(data[:half]) + decoder.feed(data[half:], 0.1):
        Sip.decode(packet)
        for command in range(256):
            decode_argument(command, packet.payload)
    # A packet of whatever kind that is too short, or no text, is one of them.
    _all_survive(data, ConfigPac.decode, GyroPac.decode, decode_names)
    Sip.decode(Packet(0x32, data))


def _driver(data):
    """The driver's side: whatever the base says, at each stage of a session."""
    for stage in range(5):
        session, now = Session(), 0.0
        session.connect(now)
        for packet in _GREETING[:stage]:
            now += 0.1
            session.receive(packet, now)
            session.tick(now)
        session.receive(data, now + 0.1)
        session.tick(now + 0.2)
        session.close(now + 0.3)


_GREETING = [encode_frame(0), encode_frame(1), *[encode_frame(*encode_names("a", "Pioneer", "p3at-sh"))] * 2]


def _lines():
    commands = [
        encode_command(Command.VEL, -120),
        encode_command(Command.SETO, 0),
        encode_command(Command.OPEN),
    ]
    firmware = Firmware("p3at-sh", PymunkRover(default_rover(), Ground(())))
    firmware.receive(b"".join(encode_frame(kind) for kind in (0, 1, 2, 1, 18)), 0.1)
    firmware.advance(0.5)
    return [*commands, b"".join(commands), firmware.data_to_send()]


# Zenoh


def _cdr(data):
    _all_survive(data, read_odometry, read_twist, read_pose, read_text, read_neurons)
    for row in KEYS:
        if row.kind is Kind.MESSAGE:
            _all_survive(data, functools.partial(decode, row.type))
            header_stamp_ns(row.type, data)


def _json(data):
    parsers = [functools.partial(lease.parse_json, model) for model in JSON_MODELS]
    _all_survive(data, lease.CommandTag.unpack, *parsers)


def _messages():
    return [
        odometry(HERE, STANDSTILL, 1),
        twist_stamped(STANDSTILL, 1),
        twist_stamped(STANDSTILL, 1)[:52],
        neurons([1.0, 2.0], ["AVA", "AVB"]),
        text("{}"),
    ]


def _jsons():
    request = lease.MotorsRequest(enable=True, name="x", sent_ns=1)
    status = lease.GateStatus(lease=1, dropped={"stale": 1})
    return [lease.dump_json(request), lease.dump_json(status), lease.CommandTag(1, 2, 3).pack()]


def _robot(data):
    """A ROS 2 robot whose topics send anything, before and after good odometry; its tokens are anything."""
    words = data.decode(errors="replace")
    tokens = [read(words) for read in (read_topic_token, read_token)]
    robot = described("turtlebot3-burger", topics={"stop": "stop", "hazards": "hazards", "docked": "dock"})
    base = Ros2Base(Line(), robot, unsafe=False)
    for token in tokens:
        if token is not None:
            base.receive(TokenSeen(token, True), 0.0)
    for k in range(40):
        now = 0.1 * (k + 1)
        good = odometry(HERE, STANDSTILL, round(1e9 * (1000 + now)), frames=("odom", "base_footprint"))
        topics = {
            "odom": data if k % 10 == 9 else good,
            **dict.fromkeys(("imu", "battery_state", "scan", "stop", "hazards", "dock"), data),
        }
        topics |= {"cmd_vel": data} if k == 35 else {}
        for topic, payload in topics.items():
            for event in base.receive(RobotMessage(topic, payload, now), now):
                if isinstance(event, BaseReport):
                    assert all(map(math.isfinite, (event.x, event.y, event.theta, event.v, event.omega)))
        base.drive(Setpoint(STANDSTILL, motors=True, emergency=False), now)
    _all_survive(f"ros2/tcp/{words}", parse_ros_address)


def _robot_messages():
    ranges = np.array([1.0, math.inf, 0.5, math.nan])
    sent = [odometry(HERE, STANDSTILL, 10**12, frames=("odom", "base_footprint")), imu(0.1, 0.1, 1)]
    tokens = [
        topic_token("abc", "odom", "nav_msgs/msg/Odometry", published=True).encode(),
        b"x:7447#rmw=zenoh",
    ]
    return [
        *sent,
        battery_state(11.0, 1),
        laser_scan(ranges, (0.1, 3.0), 1),
        twist_stamped(STANDSTILL, 1),
        *tokens,
    ]


# Files


def _yaml(data):
    words = data.decode(errors="replace")
    parsers = [functools.partial(parse_yaml, model=model, source="x.yaml") for model in YAML_MODELS]
    _all_survive(words, *parsers, lambda words: policy_from_yaml(words, "x.yaml"))


def _yamls():
    kinds = ("circuits", "courses", "policies", "randomizations", "robots")
    shipped = [read_bytes(resolve(kind, name)) for kind in kinds for name in shipped_names(kind)]
    return [*shipped, dump_yaml(Limits().model_dump()).encode(), b"a: &a [1, *a]\n", b"when: 2001-01-01\n"]


def _file(data, *reads):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        path.write_bytes(data)
        _all_survive(path, *reads)


def _recording(data):
    """A recording's bytes, corrupted anywhere."""
    _file(data, read_recording)


def _contents(data):
    """A sound recording of anything: its messages and files are corrupted, not its frame."""
    place, _, content = data.partition(b"\n")
    _file(_drive(place.decode(errors="replace"), content), read_drive, replay)


@functools.cache
def _drive(place="", content=b""):
    """A drive of one tick; what is recorded at ``place``, a topic or a file, is ``content``."""
    files, messages = _recorded()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with RecordingWriter(path) as writer:
            for name, own in files.items():
                writer.attach(name, content if name == place else own)
            for message in messages:
                writer.write(replace(message, data=content) if message.topic == place else message)
        return path.read_bytes()


@functools.cache
def _recorded():
    """The files of a drive of one tick, and its messages that are read."""
    virtual = VirtualDrive(ticks=1)
    virtual.run()
    read = {*TOPICS, "rover/status", "rover/gate"}
    files = attachments(virtual.policy, virtual.course, virtual.config)
    return files, [message for message in virtual.recorded if message.topic in read]


def _spoilable():
    files, messages = _recorded()
    topics = {message.topic: message.data for message in messages}
    samples = [name.encode() + b"\n" + content for name, content in (files | topics).items()]
    return [*samples, CONFIG_FILE.encode() + b"\nwhen: 2001-99-99"]


READERS = {
    "line": Reader(_line, _lines),
    "driver": Reader(_driver, _lines),
    "cdr": Reader(_cdr, _messages),
    "json": Reader(_json, _jsons),
    "robot": Reader(_robot, _robot_messages),
    "yaml": Reader(_yaml, _yamls),
    "recording": Reader(_recording, lambda: [_drive(), _drive()[:9] + b"\xff" * 8 + _drive()[17:]]),
    "contents": Reader(_contents, _spoilable),
}
