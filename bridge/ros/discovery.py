"""Liveliness tokens by which zenoh-bridge-ros2dds discovers our topics before the first subscription.

Form from zenoh-plugin-ros2dds (liveliness_mgt.rs; facts only): ``@/ZID/@ros2_lv`` for a bridge, and below it
``MP`` (publisher) or ``MS`` (subscriber), key, type, QoS, each with § for /. Access control that denies by
default lets no token of the bridge out but its own: there ``ros2 topic list`` shows a topic once subscribed.
"""

# No keys; reliable; volatile or transient local; keep the last 10 or 1 (Cyclone DDS' numbers).
_KEEP_10, _LATCHED = ":1:0:0,10", ":1:1:0,1"


def bridge_token(zid: str) -> str:
    """Return the token of a bridge with this Zenoh id."""
    return f"@/{zid}/@ros2_lv"


def topic_token(zid: str, key: str, ros_type: str, published: bool, latched: bool = False) -> str:
    """Return the token of a topic on ``key`` with a type such as ``nav_msgs/msg/Odometry``."""
    kind = "MP" if published else "MS"
    qos = _LATCHED if latched else _KEEP_10
    return f"{bridge_token(zid)}/{kind}/{key.replace('/', '§')}/{ros_type.replace('/', '§')}/{qos}"
