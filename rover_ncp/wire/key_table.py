"""The table of all Zenoh keys: the content of each, its senders and its receivers.

Messages are ROS 2 types in CDR on plain keys, so that ROS bridges need no adapter. `key` prefixes the
namespace, not Zenoh's own setting, which would also prefix the ``@`` tokens of ROS bridges.
Access control and documentation are made from this table.
"""

import re
from dataclasses import dataclass
from enum import Enum

from rover_ncp.core.errors import UsageError


class Role(Enum):
    """Role of a peer in access control."""

    BRIDGE = "bridge"
    DRIVER = "driver"
    VIEWER = "viewer"
    LOCALISER = "localiser"
    """External localisation: sends poses and what is known of them, and receives nothing."""


class Kind(Enum):
    """How a key is used."""

    MESSAGE = "message"
    QUERYABLE = "queryable"
    """Senders query, the one receiver replies; JSON both ways (`rover_ncp.wire.protocol`)."""
    TOKEN = "token"
    """A liveliness token: it exists as long as its sender."""


ALL = frozenset({Role.BRIDGE, Role.DRIVER, Role.VIEWER})
BRIDGE, DRIVER = frozenset({Role.BRIDGE}), frozenset({Role.DRIVER})


@dataclass(frozen=True)
class KeySpec:
    """A row: ``type`` is a ROS type or names JSON models; payloads over ``max_bytes`` are refused.

    Late subscribers to a ``latched`` key receive its last message. A ``shown`` one is for people: no drive
    uses it, and a recording that falls behind leaves it out.
    """

    name: str
    type: str
    max_bytes: int
    about: str
    senders: frozenset[Role] = BRIDGE
    receivers: frozenset[Role] = ALL
    kind: Kind = Kind.MESSAGE
    latched: bool = False
    shown: bool = False


def _query(name: str, model: str, about: str) -> KeySpec:
    return KeySpec(name, model, 4096, about, DRIVER, BRIDGE, Kind.QUERYABLE)


_POSE, _STRING = "geometry_msgs/msg/PoseWithCovarianceStamped", "std_msgs/msg/String"
TAG_VIEW, TAG_OUTLINES = "tag_view/compressed", "tag_view/annotations"
_TF, _TWIST = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TwistStamped"

KEYS: tuple[KeySpec, ...] = (
    KeySpec("odom", "nav_msgs/msg/Odometry", 4096, "pose and velocity of the base, each SIP"),
    KeySpec("imu", "sensor_msgs/msg/Imu", 4096, "rate of turn of a base with a gyro of its own, each SIP"),
    KeySpec("tf", _TF, 4096, "odom → base_link, each SIP"),
    KeySpec("tf_static", _TF, 1 << 16, "poses of the sensors on the base", latched=True),
    KeySpec("battery_state", "sensor_msgs/msg/BatteryState", 4096, "once a second"),
    KeySpec("docked", "std_msgs/msg/Bool", 512, "whether a ROS 2 robot is docked, by each of its messages"),
    KeySpec("sonar", "sensor_msgs/msg/PointCloud2", 1 << 16, "the echoes of one SIP, in base_link"),
    KeySpec("bumpers", "std_msgs/msg/UInt8MultiArray", 4096, "front and rear bits, 1 = pressed, each SIP"),
    KeySpec("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 1 << 16, "base, link and gate"),
    # The gate's output: the command that reached the base, and the reasons for dropped ones.
    KeySpec("rover/cmd_out", _TWIST, 512, "the command that the gate accepted"),
    KeySpec("rover/gate", _STRING, 4096, "GateStatus as JSON: driver, stop, counters"),
    KeySpec("cmd_vel", _TWIST, 512, "the driver's command; the attachment is a signed CommandTag", DRIVER),
    KeySpec(
        "pose",
        _POSE,
        4096,
        "optional external localisation, in the frame of the course or of the place; also a PoseStamped",
        frozenset({Role.BRIDGE, Role.DRIVER, Role.LOCALISER}),
    ),
    KeySpec(
        TAG_VIEW,
        "sensor_msgs/msg/CompressedImage",
        1 << 16,
        "what a localiser's camera sees, twice a second, for `watch` and recordings",
        frozenset({Role.DRIVER, Role.LOCALISER}),
        frozenset({Role.DRIVER, Role.VIEWER}),
        shown=True,
    ),
    KeySpec(
        TAG_OUTLINES,
        "foxglove_msgs/msg/ImageAnnotations",
        1 << 16,
        "the tags in that picture, for recordings",
        frozenset({Role.DRIVER, Role.LOCALISER}),
        DRIVER,
        shown=True,
    ),
    KeySpec(
        "rover/localiser",
        _STRING,
        512,
        "Declaration as JSON: the error that the poses of a frame have for seconds, twice a second",
        frozenset({Role.DRIVER, Role.LOCALISER}),
    ),
    KeySpec("rover/estimate", _POSE, 4096, "the driver's own estimate", DRIVER),
    KeySpec("rover/neurons", "std_msgs/msg/Float64MultiArray", 1 << 16, "potentials in mV, labelled", DRIVER),
    KeySpec("rover/status", _STRING, 4096, "DriverStatus as JSON", DRIVER),
    _query(
        "rover/motors",
        "MotorsRequest → MotorsReply",
        "enable, renew or release; grants the lease and its key",
    ),
    _query("rover/stop", "StopRequest → StopReply", "stop, latched until released"),
    _query("rover/base", "BaseRequest → BaseReply", "model, timeout and inputs of the base"),
    KeySpec("rover/alive/bridge", "", 0, "the bridge runs", kind=Kind.TOKEN),
    KeySpec("rover/alive/driver", "", 0, "a driver runs", DRIVER, kind=Kind.TOKEN),
)

_BY_NAME = {row.name: row for row in KEYS}
# Zenoh reserves * $ # ? and chunks that begin with @; ROS allows letters, digits, _ and /.
_NAMESPACE = re.compile(r"[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")


def spec(name: str) -> KeySpec:
    """Return a row of the table. KeyError for a name that is not in it."""
    return _BY_NAME[name]


def key(namespace: str, name: str) -> str:
    """Return the full key of a row: ``key("bot1", "odom")`` is ``bot1/odom``; "" is no namespace.

    Slashes around the namespace, as ROS writes them, are removed. Raises UsageError for an invalid one.
    """
    return _below(namespace, _BY_NAME[name].name)


def topic_key(namespace: str, topic: str) -> str:
    """Return the key of a ROS topic, which is not in the table; one that begins with / has no namespace.

    Raises UsageError for a name that is none.
    """
    if not _NAMESPACE.fullmatch(topic.removeprefix("/")):
        raise UsageError(f"topic {topic!r}: expected names of letters, digits, _ and -, joined by /")
    return topic[1:] if topic.startswith("/") else _below(namespace, topic)


def _below(namespace: str, name: str) -> str:
    stripped = namespace.strip("/")
    if not stripped:
        return name
    if not _NAMESPACE.fullmatch(stripped):
        raise UsageError(f"namespace {namespace!r}: expected names of letters, digits, _ and -, joined by /")
    return f"{stripped}/{name}"
