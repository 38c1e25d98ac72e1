"""Forms in which ROS 2 can discover the bridge's topics, beside the plain keys."""

from enum import StrEnum


class Convention(StrEnum):
    """A name for ``--ros``."""

    ROS2DDS = "ros2dds"
    """zenoh-bridge-ros2dds: the plain keys, and a token for each."""
    RMW_ZENOH = "rmw-zenoh"
    """ROS 2 nodes whose own middleware is Zenoh (RMW_IMPLEMENTATION=rmw_zenoh_cpp)."""
