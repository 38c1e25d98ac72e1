"""Ways by which a test's node publishes and subscribes: rclpy on DDS, and two implementations of rmw_zenoh in Python.

Messages are dicts of their fields; what is left out has the type's default. ROS's own serialiser makes the bytes
for all of them, so that what differs is how they travel.
"""

import importlib
import math
import os
import time


def header(stamp_s, frame):
    seconds = math.floor(stamp_s)
    return {"stamp": {"sec": seconds, "nanosec": int((stamp_s - seconds) * 1e9)}, "frame_id": frame}


def message_class(ros_type):
    package, _, name = ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill(message, fields):
    """Set the fields of a message, which may have messages within it, and return it."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            part = message_class(
                message.get_fields_and_field_types()[name]
                .removeprefix("sequence<")
                .rstrip(">")
                .replace("/", "/msg/")
            )
            setattr(message, name, [fill(part(), item) for item in value])
        else:
            setattr(message, name, value)
    return message


class Rclpy:
    """A node of ROS 2's own Python library."""

    def __init__(self, namespace, name, router):
        import rclpy

        rclpy.init()
        self.rclpy, self.node = rclpy, rclpy.create_node(name, namespace=namespace or None)

    def publisher(self, topic, ros_type, reliable=True, latched=False):
        from relay import profile

        kind = message_class(ros_type)
        publisher = self.node.create_publisher(kind, topic, profile(reliable, latched))
        return lambda fields: publisher.publish(fill(kind(), fields))

    def subscribe(self, topic, ros_type, receive, reliable=True, latched=False):
        from relay import profile

        self.node.create_subscription(message_class(ros_type), topic, receive, profile(reliable, latched))

    def spin(self, seconds):
        self.rclpy.spin_once(self.node, timeout_sec=seconds)


WIRES = {"rclpy": Rclpy}
