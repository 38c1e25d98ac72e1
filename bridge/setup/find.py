"""What can be found of a robot: serial ports, a Pioneer on one, a ROS 2 robot behind its router, cameras."""

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from serial.tools.list_ports import comports

from bridge.base import Failed, Ready, Setpoint
from bridge.inbox import Inbox, ThreadError
from bridge.pioneer.base import ArcosBase
from bridge.pioneer.connection import BaseConnection
from bridge.pioneer.session import Session
from bridge.pioneer.setpoints import MotionLimits
from bridge.ros2.address import command_type, hazard_topics, sensor_topics
from bridge.ros2.discovery import Announced, read_topic_token
from bridge.ros2.rmw import read_token
from rover_ncp.core.errors import NoRobot
from rover_ncp.core.files import shipped_names
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import ODOMETRY
from rover_ncp.wire.zenoh import open_robot

PROBE_S = 20.0
"""Longest wait for a Pioneer's answer; a line without one gives up before."""
TICK_S = 0.02
TOKENS_S = 2.0
BY_ID = Path("/dev/serial/by-id")
ANY_MODEL = "turtlebot4"
"""The first proposal for a robot that fits no shipped description."""
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


class SerialPort(NamedTuple):
    """A serial port: a path that it keeps if there is one, and what the system calls the device."""

    path: str
    name: str


class RosRobot(NamedTuple):
    """A ROS 2 robot behind a router: its address, the model that fits best, its topics with pictures."""

    address: str
    model: str
    images: tuple[str, ...]


class CameraFound(NamedTuple):
    """A camera of this machine."""

    path: str
    name: str


def serial_ports() -> list[SerialPort]:
    """Return the serial ports of this machine that are devices of their own. Sends nothing."""
    lasting = {each.resolve(): each for each in BY_ID.iterdir()} if BY_ID.is_dir() else {}
    found = [port for port in comports() if port.vid is not None]  # not the mainboard's empty connectors
    return [SerialPort(str(lasting.get(Path(port.device), port.device)), port.description) for port in found]


def pioneer_at(address: str) -> str:
    """Return the name of the base that answers at an address; its motors stay off. Raises NoRobot."""
    inbox = Inbox()
    base = ArcosBase(BaseConnection(address, inbox), Session(None, MotionLimits()))
    still, deadline_s = Setpoint(STANDSTILL, motors=False, emergency=False), time.monotonic() + PROBE_S
    try:
        while (now := time.monotonic()) < deadline_s:
            events = list(base.drive(still, now))
            for _, arrival in inbox.take(TICK_S):
                if isinstance(arrival, ThreadError):
                    raise NoRobot(str(arrival.error))
                events += base.receive(arrival, time.monotonic())
            for event in events:
                if isinstance(event, Ready):
                    return event.hardware
                if isinstance(event, Failed):
                    raise NoRobot(event.reason)
    finally:
        base.close(time.monotonic())
    raise NoRobot(f"{address}: no answer within {PROBE_S:g} s")


def ros_robots_at(endpoint: str) -> list[RosRobot]:
    """Return the robots whose odometry is announced at a router. Raises NoRobot."""
    found = dict[str, list[Announced]]()
    session = open_robot(endpoint)
    try:
        for pattern in ("@/*/@ros2_lv/**", "@ros2_lv/**"):
            for reply in session.liveliness().get(pattern, timeout=TOKENS_S):
                if reply.ok is None:
                    continue
                token = str(reply.ok.key_expr)
                if (announced := read_topic_token(token) or read_token(token)) is not None:
                    form = f"rmw=zenoh&domain={token.split('/')[1]}" if token[1] == "r" else ""
                    found.setdefault(form, []).append(announced)
    finally:
        session.close()  # type: ignore[no-untyped-call]
    return [robot for form, topics in found.items() for robot in robots_among(endpoint, form, topics)]


def robots_among(endpoint: str, form: str, announced: Iterable[Announced]) -> list[RosRobot]:
    """Return the robots among topics that one form of Zenoh integration announces. Pure.

    An odometry topic may be that of several models, in namespaces within each other: the best fit counts.
    """
    topics = {(each.topic, each.ros_type) for each in announced}
    fits = [fit for topic, kind in topics if kind == ODOMETRY for fit in _fits(topic, topics)]
    best = dict[str, _Fit]()
    for fit in sorted(fits, key=lambda each: (-each.score, each.namespace, each.model)):
        outer = [name for name in best if f"{fit.namespace}/".startswith(f"{name}/" if name else "")]
        if all(best[name].score <= fit.score and name != fit.namespace for name in outer):
            best[fit.namespace] = fit
    robots = []
    for space, fit in sorted(best.items()):
        settings = "&".join(part for part in (form, f"namespace={space}" if space else "") if part)
        prefix = f"{space}/" if space else ""
        images = sorted(
            name.removeprefix(prefix) for name, kind in topics if kind in IMAGES and name.startswith(prefix)
        )
        address = f"ros2/{endpoint}{f'#{settings}' if settings else ''}"
        robots.append(RosRobot(address, fit.model, tuple(images)))
    return robots


class _Fit(NamedTuple):
    score: float
    namespace: str
    model: str


def _fits(odometry: str, topics: set[tuple[str, str]]) -> Iterator[_Fit]:
    """Yield each shipped model that an odometry topic may belong to, and one for a robot of another model."""
    yield _Fit(-math.inf, odometry.rpartition("/")[0], ANY_MODEL)
    for model in shipped_names("robots"):
        named = load_description(model).topics
        if named is None or not f"/{odometry}".endswith(f"/{named.odom}"):
            continue
        space = odometry.removesuffix(named.odom).rstrip("/")
        wanted = [*sensor_topics(named), *((each.topic, kind) for each, kind in hazard_topics(named))]
        wanted.append((named.cmd_vel, command_type(named)))
        present = sum((f"{space}/{name}".lstrip("/"), kind) in topics for name, kind in wanted)
        yield _Fit(1.5 * present - 0.5 * len(wanted), space, model)


def cameras(complain: Callable[[str], None]) -> list[CameraFound]:
    """Return the cameras of this machine, as 'tag cameras' lists them."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "rover_ncp", "tag", "cameras", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        answer = json.loads(done.stdout)
        return [CameraFound(each["stable"] or each["path"], each["name"]) for each in answer["cameras"]]
    except (ValueError, KeyError):
        complain(f"cameras cannot be listed: {done.stderr.strip().removeprefix('rover-ncp: ')}")
        return []
