"""Ways by which a test's node publishes and subscribes.

rclpy on DDS, and two implementations of rmw_zenoh in Python that know nothing of this project. Messages are
dicts of their fields; what is left out has the type's default.
"""

import importlib
import json
import math
import os
import queue
import select
import sys
from pathlib import Path

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message


def header(stamp_s, frame):
    """Return a header; ``stamp_s`` is of any clock."""
    seconds = math.floor(stamp_s)
    return {"stamp": {"sec": seconds, "nanosec": int((stamp_s - seconds) * 1e9)}, "frame_id": frame}


def input_lines():
    """Return the lines of the standard input since the last call; None when it has ended."""
    if not select.select([sys.stdin], [], [], 0)[0]:
        return []
    text = os.read(0, 4096).decode()
    return text.splitlines() if text else None


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


class OnZenoh:
    """What both implementations of rmw_zenoh share: their messages arrive on Zenoh's threads."""

    def __init__(self, name, namespace, router):
        self.name, self.namespace, self.router, self.arrived = name, namespace, router, queue.SimpleQueue()

    def path(self, topic):
        """Return a topic with the namespace."""
        return f"/{self.namespace}/{topic}" if self.namespace else f"/{topic}"

    def spin(self, seconds):
        """Wait for a message so long, and handle it."""
        try:
            receive, message = self.arrived.get(timeout=max(seconds, 0.001))
        except queue.Empty:
            return
        receive(message)

    def close(self):
        """End, with the session."""


class Sdk(OnZenoh):
    """zenoh-ros2-sdk: it downloads definitions that it does not find; ROS's packages have them."""

    def __init__(self, name, namespace, router):
        super().__init__(name, namespace, router)
        from zenoh_ros2_sdk.message_registry import get_registry
        from zenoh_ros2_sdk.session import ZenohSession

        host, port = router.split(":")
        self.session = ZenohSession.get_instance(host, int(port))
        get_registry(str(Path(sys.prefix) / "share"))

    def publisher(self, topic, ros_type, reliable=True):
        from zenoh_ros2_sdk import ROS2Publisher

        publisher = ROS2Publisher(self.path(topic), ros_type, node_name=self.name)
        kind, store = message_class(ros_type), self.session.store

        def publish(fields):
            # Its messages take all fields: ROS's own have the defaults of those left out.
            data = serialize_message(fill(kind(), fields))
            publisher.publish(**vars(store.deserialize_cdr(data, ros_type)))

        return publish

    def subscribe(self, topic, ros_type, receive, reliable=True):
        from zenoh_ros2_sdk import ROS2Subscriber

        def put(message):
            self.arrived.put((receive, message))

        self.held = ROS2Subscriber(self.path(topic), ros_type, put, node_name=self.name)


class Pyzeros(OnZenoh):
    """pyzeros: its codecs compile at their first use for seconds, so it is given bytes."""

    def __init__(self, name, namespace, router):
        super().__init__(name, namespace, router)
        import pyzeros
        import zenoh

        config = zenoh.Config()
        settings = {"mode": "client", "connect/endpoints": [f"tcp/{router}"]}
        for path, value in {**settings, "scouting/multicast/enabled": False}.items():
            config.insert_json5(path, json.dumps(value))
        self.node = pyzeros.Node(name, zenoh.open(config), namespace=f"/{namespace}")
        self.held = []

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


WIRES = {"rclpy": Rclpy, "zenoh-ros2-sdk": Sdk, "pyzeros": Pyzeros}
