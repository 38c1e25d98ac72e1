"""What the tests with ROS 2 share. ``make test-ros`` runs them."""

from ros.rig import ROS2DDS_BRIDGE


def pytest_report_header():
    """Say which program carried the topics."""
    return f"between DDS and Zenoh: {ROS2DDS_BRIDGE or 'a stand-in for zenoh-bridge-ros2dds'}"
