"""Ways by which a test's node publishes and subscribes.

rclpy on DDS, and an implementation of rmw_zenoh in Python that knows nothing of this project. Messages are
dicts of their fields; what is left out has the type's default.
"""

import importlib
import json
import math
import queue
import select
import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message


def header(stamp_s, frame):
    """Return a header; ``stamp_s`` is of any clock."""
    seconds = math.floor(stamp_s)
    return {"stamp": {"sec": seconds, "nanosec": int((stamp_s - seconds) * 1e9)}, "frame_id": frame}


def input_open():
    """Return whether the standard input has not ended yet."""
    return not select.select([sys.stdin], [], [], 0)[0]


def message_class(ros_type):
    """Return the class of a type such as ``nav_msgs/msg/Odometry``. Raises ImportError."""
    package, _, name = ros_type.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill(message, fields):
    """Set the fields of a message, which may have messages within it, and return it."""
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def profile(reliable=True, latched=False):
    """Return the QoS of a topic: of a sensor's, a reader that was held up has the newest message alone."""
    return QoSProfile(
        depth=10 if reliable and not latched else 1,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class Rclpy:
    """A node of ROS 2's own library."""

    def __init__(self, name, namespace, router):
        rclpy.init()
        self.node = rclpy.create_node(name, namespace=namespace or None)

    def publisher(self, topic, ros_type, reliable=True):
        """Return a function that publishes a message of these fields."""
        kind = message_class(ros_type)
        publisher = self.node.create_publisher(kind, topic, profile(reliable))
        return lambda fields: publisher.publish(fill(kind(), fields))

    def subscribe(self, topic, ros_type, receive, reliable=True):
        """Call ``receive`` with each message while the node spins."""
        self.node.create_subscription(message_class(ros_type), topic, receive, profile(reliable))

    def spin(self, seconds):
        """Wait for a message so long, and handle it."""
        rclpy.spin_once(self.node, timeout_sec=seconds)

    def close(self):
        """Let the others of the graph know that the node ends."""
        self.node.destroy_node()
        rclpy.shutdown()


class Pyzeros:
    """pyzeros: its codecs compile at their first use for seconds, so it is given bytes."""

    def __init__(self, name, namespace, router):
        import pyzeros
        import zenoh

        config = zenoh.Config()
        settings = {"mode": "client", "connect/endpoints": [f"tcp/{router}"]}
        for path, value in {**settings, "scouting/multicast/enabled": False}.items():
            config.insert_json5(path, json.dumps(value))
        self.node = pyzeros.Node(name, zenoh.open(config), namespace=f"/{namespace}")
        self.held, self.arrived = [], queue.SimpleQueue()

    def spin(self, seconds):
        """Wait for a message so long, and handle it: messages arrive on Zenoh's threads."""
        try:
            receive, message = self.arrived.get(timeout=max(seconds, 0.001))
        except queue.Empty:
            return
        receive(message)

    def close(self):
        """End, with the session."""

    @staticmethod
    def type(ros_type):
        """Return pyzeros' class of a type, which has name and hash."""
        from ros2_pyterfaces.cydr import all_msgs

        return getattr(all_msgs, ros_type.rpartition("/")[2])

    def publisher(self, topic, ros_type, reliable=True):
        import pyzeros

        publisher = pyzeros.Pub(self.type(ros_type), topic, session=self.node, scope=None)
        kind = message_class(ros_type)
        return lambda fields: publisher.publish(serialize_message(fill(kind(), fields)))

    def subscribe(self, topic, ros_type, receive, reliable=True):
        from pyzeros.sub import RawSub

        kind = message_class(ros_type)

        def put(sample):
            self.arrived.put((receive, deserialize_message(sample.payload.to_bytes(), kind)))

        self.held.append(RawSub(self.type(ros_type), topic, put, session=self.node, scope=None))


WIRES = {"rclpy": Rclpy, "pyzeros": Pyzeros}
