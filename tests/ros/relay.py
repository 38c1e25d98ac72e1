"""A stand-in for zenoh-bridge-ros2dds, for machines that do not have it: rclpy and Zenoh.

It passes on CDR bytes unread and does what the bridge's sources say (zenoh-plugin-ros2dds 1.x: routes_mgr.rs,
route_publisher.rs, route_subscriber.rs, liveliness_mgt.rs; facts only). Keys are plain topic names; topics
have no attachment. A route has a token while a local node uses it. Each name and direction has one route, of
the first type seen. A DDS reader exists only while a Zenoh subscriber matches. It leaves out services and
actions, late samples of latched topics to DDS, and topics whose type has no Python package here.
"""

import argparse
import json
import time
from collections import deque

import rclpy
import zenoh
import zenoh.ext
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from wires import input_open, message_class, profile

NODE = "relay"
SCAN_S = 0.1
HIDDEN = {"/rosout", "/parameter_events", "/ros_discovery_info"}


class Route:
    """A topic in one direction. ``local`` are nodes on DDS, ``remote`` are Zenoh ids that announced it."""

    def __init__(self, relay, topic, ros_type, reliable, latched):
        self.relay, self.topic, self.key, self.ros_type = relay, topic, topic.lstrip("/"), ros_type
        self.qos = f":{int(reliable)}:{int(latched)}:0,{1 if latched else 10}"
        self.profile, self.latched, self.type = profile(reliable, latched), latched, message_class(ros_type)
        self.local, self.remote, self.token = set(), set(), None

    def announce(self, kind):
        """Hold a token while a local node uses the route."""
        if self.local and self.token is None:
            parts = [text.replace("/", "§") for text in (self.key, self.ros_type)]
            token = "/".join([self.relay.token, kind, *parts, self.qos])
            self.token = self.relay.session.liveliness().declare_token(token)
            print(f"announced {self.key} {self.ros_type}", flush=True)
        elif not self.local and self.token is not None:
            self.token.undeclare()
            self.token = None


class ToZenoh(Route):
    """From DDS to Zenoh."""

    kind = "MP"

    def __init__(self, *route):
        super().__init__(*route)
        cache = zenoh.ext.CacheConfig(max_samples=1) if self.latched else None
        remote = zenoh.Locality.REMOTE
        if self.latched:
            self.publisher = zenoh.ext.declare_advanced_publisher(
                self.relay.session,
                self.key,
                cache=cache,
                publisher_detection=True,
                allowed_destination=remote,
            )
        else:
            self.publisher = self.relay.session.declare_publisher(
                self.key,
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=remote,
            )
        self.reader = None

    def update(self):
        self.announce(self.kind)
        # An advanced publisher does not say whether a subscriber matches.
        wanted = self.latched or self.publisher.matching_status.matching
        if wanted and self.reader is None:
            self.reader = self.relay.node.create_subscription(
                self.type, self.topic, self.receive, self.profile, raw=True
            )
        elif not wanted and self.reader is not None:
            self.relay.node.destroy_subscription(self.reader)
            self.reader = None

    def receive(self, data):
        if data in self.relay.written:  # our own writer's: DDS has an option to ignore it, rclpy has not
            self.relay.written.remove(data)
            return
        self.publisher.put(data)

    def close(self):
        if self.reader is not None:
            self.relay.node.destroy_subscription(self.reader)
        self.publisher.undeclare()


class ToDds(Route):
    """From Zenoh to DDS."""

    kind = "MS"

    def __init__(self, *route):
        super().__init__(*route)
        self.writer = self.relay.node.create_publisher(self.type, self.topic, self.profile)
        self.subscriber = self.relay.session.declare_subscriber(
            self.key, self.receive, allowed_origin=zenoh.Locality.REMOTE
        )

    def update(self):
        self.announce(self.kind)

    def receive(self, sample):
        data = sample.payload.to_bytes()
        self.relay.written.append(data)  # whether or not there is a reader: one may come while this is sent
        self.writer.publish(data)

    def close(self):
        self.subscriber.undeclare()
        self.relay.node.destroy_publisher(self.writer)


class Relay:
    """All routes. Tokens of other sessions arrive in ``tokens``, from Zenoh's thread."""

    def __init__(self, listen, connect):
        config = zenoh.Config()
        settings = {"mode": "router", "scouting/multicast/enabled": False, "scouting/delay": 0}
        settings |= {"listen/endpoints": listen, "connect/endpoints": connect}
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        rclpy.init()
        self.node = rclpy.create_node(NODE)
        self.session = zenoh.open(config)
        self.routes, self.written, self.tokens = {}, deque(maxlen=100), deque()
        self.zid = str(self.session.info.zid())
        self.token = f"@/{self.zid}/@ros2_lv"
        liveliness = self.session.liveliness()
        self.held = [
            liveliness.declare_token(self.token),
            liveliness.declare_subscriber("@/*/@ros2_lv/**", self.tokens.append, history=True),
        ]

    def run(self):
        due = 0.0
        while input_open():
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if time.monotonic() >= due:
                due = time.monotonic() + SCAN_S
                self.scan()
        self.session.close()
        self.node.destroy_node()
        rclpy.shutdown()

    def scan(self):
        while self.tokens:
            self.remote(self.tokens.popleft())
        for topic, _ in self.node.get_topic_names_and_types():
            if topic not in HIDDEN:
                self.local(ToZenoh, topic, self.node.get_publishers_info_by_topic(topic))
                self.local(ToDds, topic, self.node.get_subscriptions_info_by_topic(topic))
        names = {topic for topic, _ in self.node.get_topic_names_and_types()}
        for (direction, topic), route in list(self.routes.items()):
            if topic not in names:
                route.local = set()
            route.update()
            if not route.local and not route.remote:
                route.close()
                del self.routes[direction, topic]

    def local(self, direction, topic, endpoints):
        others = [end for end in endpoints if end.node_name != NODE]
        if others and (direction, topic) not in self.routes:
            qos = others[0].qos_profile
            reliable = qos.reliability == ReliabilityPolicy.RELIABLE
            latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            self.open(direction, topic, others[0].topic_type, reliable, latched)
        if (direction, topic) in self.routes:
            self.routes[direction, topic].local = {end.node_name for end in others}

    def remote(self, sample):
        match str(sample.key_expr).split("/"):
            case ["@", zid, "@ros2_lv", "MP" | "MS" as kind, key, ros_type, qos] if zid != self.zid:
                direction = ToDds if kind == "MP" else ToZenoh
                topic = "/" + key.replace("§", "/")
                there = sample.kind == zenoh.SampleKind.PUT
                _, reliable, durability, *_ = qos.split(":")
                if there and (direction, topic) not in self.routes:
                    self.open(
                        direction, topic, ros_type.replace("§", "/"), reliable == "1", durability == "1"
                    )
                if (route := self.routes.get((direction, topic))) is not None:
                    (route.remote.add if there else route.remote.discard)(zid)

    def open(self, direction, topic, ros_type, reliable, latched):
        try:
            self.routes[direction, topic] = direction(self, topic, ros_type, reliable, latched)
        except ImportError:
            print(f"relay: no Python package for {ros_type}: {topic} is left out", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-l", dest="listen", action="append", default=[])
    parser.add_argument("-e", dest="connect", action="append", default=[])
    arguments = parser.parse_args()
    relay = Relay(arguments.listen, arguments.connect)
    print("ready", flush=True)
    relay.run()


if __name__ == "__main__":
    main()
