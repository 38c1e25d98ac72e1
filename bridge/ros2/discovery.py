"""Forms in which ROS 2 can discover the bridge's topics, beside the plain keys, and the tokens of the first.

zenoh-bridge-ros2dds discovers topics by liveliness tokens before the first subscription. Form from
zenoh-plugin-ros2dds (liveliness_mgt.rs; facts only): ``@/ZID/@ros2_lv`` for a bridge, and below it ``MP``
(publisher) or ``MS`` (subscriber), key, type, QoS, each with § for /. Access control that denies by default
blocks these tokens: then ``ros2 topic list`` shows a topic only once it is subscribed.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

# No keys; reliable; volatile or transient local; keep the last 10 or 1 (Cyclone DDS' numbers).
_KEEP_10, _LATCHED = ":1:0:0,10", ":1:1:0,1"
# A DDS reader that asks for reliability gets nothing from a best-effort writer, as those of sensors are.
_BEST_EFFORT = ":0:0:0,10"


class Convention(StrEnum):
    """A name for ``--ros``."""

    ROS2DDS = "ros2dds"
    """zenoh-bridge-ros2dds: the plain keys, and a token for each."""
    RMW_ZENOH = "rmw-zenoh"
    """ROS 2 nodes whose own middleware is Zenoh (RMW_IMPLEMENTATION=rmw_zenoh_cpp)."""


def bridge_token(zid: str) -> str:
    """Return the token of a bridge with this Zenoh id."""
    return f"@/{zid}/@ros2_lv"


def topic_token(
    zid: str, key: str, ros_type: str, published: bool, latched: bool = False, *, reliable: bool = True
) -> str:
    """Return the token of a topic on ``key`` with a type such as ``nav_msgs/msg/Odometry``."""
    kind = "MP" if published else "MS"
    qos = _LATCHED if latched else _KEEP_10 if reliable else _BEST_EFFORT
    return f"{bridge_token(zid)}/{kind}/{key.replace('/', '§')}/{ros_type.replace('/', '§')}/{qos}"


class Announced(NamedTuple):
    """A topic that a token announces, of either form; ``topic`` has no leading slash.

    ``who`` names the node, or the ROS bridge where the token does not say which node it is.
    """

    zid: str
    published: bool
    topic: str
    ros_type: str
    who: str
    source: bytes | None = None
    """The publisher's identity in its messages, where the form has one."""


def read_topic_token(token: str) -> Announced | None:
    """Return what a token of zenoh-bridge-ros2dds announces; None for other tokens."""
    match token.split("/"):
        case ["@", zid, "@ros2_lv", "MP" | "MS" as kind, topic, ros_type, *_]:
            names = topic.replace("§", "/"), ros_type.replace("§", "/")
            return Announced(zid, kind == "MP", *names, f"zenoh-bridge-ros2dds {zid[:8]}")
    return None


@dataclass(frozen=True)
class TokenSeen:
    """A topic was announced, or is announced no more."""

    token: Announced
    there: bool


@dataclass(frozen=True)
class LoopSeen:
    """Whether the robot's side can be seen from the drivers' side."""

    there: bool
