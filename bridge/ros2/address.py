"""The address of a ROS 2 robot: where its Zenoh router is, and in which form its topics are there."""

from dataclasses import dataclass
from pathlib import Path

from bridge.ros2.discovery import Convention
from rover_ncp.core.console import printable
from rover_ncp.core.errors import UsageError
from rover_ncp.robot.topics import HazardTopic, Topics
from rover_ncp.wire.address import parse_ros_endpoint
from rover_ncp.wire.messages import (
    BATTERY_STATE,
    BOOL,
    DOCKED_TYPES,
    HAZARDS,
    IMU,
    LASER_SCAN,
    ODOMETRY,
    POSE_STAMPED,
    POSE_WITH_COVARIANCE,
    TWIST,
    TWIST_STAMPED,
)
from rover_ncp.wire.zenoh import PORT

_FORM = (
    "expected ros2/tcp/HOST[:PORT], then #rmw=zenoh&domain=N for rmw_zenoh (&distro=humble for Humble's), "
    "&namespace=NAME for a namespace"
)


@dataclass(frozen=True)
class RosAddress:
    """``endpoint`` is a Zenoh endpoint; ``namespace`` is put before all topics.

    ``hashed`` is whether keys of rmw_zenoh have type hashes: Humble's have none.
    """

    endpoint: str
    convention: Convention = Convention.ROS2DDS
    domain: int = 0
    namespace: str = ""
    hashed: bool = True
    zenoh_config: Path | None = None


def parse_ros_address(text: str, zenoh_config: Path | None = None) -> RosAddress:
    """Read ``ros2/tcp/HOST[:PORT][#rmw=zenoh&domain=N&namespace=NAME]``. Raises UsageError."""
    where = parse_ros_endpoint(text, PORT)
    settings = {} if where is None else dict(where.settings)
    distro = settings.pop("distro", "jazzy")
    if where is None or distro not in {"jazzy", "humble"} or settings:
        raise UsageError(f"base {printable(text)}: {_FORM}")
    return RosAddress(
        where.endpoint,
        Convention.RMW_ZENOH if where.rmw_zenoh else Convention.ROS2DDS,
        where.domain,
        where.namespace,
        hashed=distro != "humble",
        zenoh_config=zenoh_config,
    )


def sensor_topics(topics: Topics) -> list[tuple[str, str]]:
    """Return name and type of each topic that a robot publishes for its base."""
    found = [(topics.odom, ODOMETRY), (topics.imu, IMU), (topics.battery_state, BATTERY_STATE)]
    found += [(topics.scan, LASER_SCAN), (topics.pose, pose_type(topics))]
    found.append((topics.docked, DOCKED_TYPES[topics.docked_field]))
    return [(name, ros_type) for name, ros_type in found if name is not None]


def hazard_topics(topics: Topics) -> list[tuple[HazardTopic, str]]:
    """Return each topic that reports hazards, and its type."""
    found = ((topics.stop, BOOL), (topics.hazards, HAZARDS))
    return [(topic, ros_type) for topic, ros_type in found if topic is not None]


def command_type(topics: Topics) -> str:
    """Return the type of a robot's commands."""
    return TWIST_STAMPED if topics.cmd_vel_type == "TwistStamped" else TWIST


def pose_type(topics: Topics) -> str:
    """Return the type of the poses of a robot's own localiser."""
    return POSE_STAMPED if topics.pose_type == "PoseStamped" else POSE_WITH_COVARIANCE
