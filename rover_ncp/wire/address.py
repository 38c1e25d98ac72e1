"""Addresses of bases, robots and bridges: ``PROTOCOL/HOST[:PORT][#SETTINGS]``; of ROS 2 robots ``ros2/``."""

import re
from typing import NamedTuple

_FORM = re.compile(r"([a-z]+)/(\[[0-9A-Fa-f:.]+\]|[^/:#?\[\]\s]+)(?::(\d+))?([#?]\S*)?")
MAX_PORT = 65535
MAX_DOMAIN = 232
"""The largest ROS_DOMAIN_ID whose ports DDS has."""
ROS2 = "ros2/"


class Address(NamedTuple):
    """One end of a connection. ``host`` has no brackets; ``settings`` begins with ``#`` or ``?``."""

    protocol: str
    host: str
    port: int
    settings: str = ""

    @property
    def connectable(self) -> bool:
        """Whether the port is one to connect to."""
        return 0 < self.port <= MAX_PORT

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}{self.settings}"


def parse_address(text: str, default_port: int) -> Address | None:
    """Read an address; None for another form. The port may be any number."""
    match = _FORM.fullmatch(text)
    if match is None:
        return None
    protocol, host, port, settings = match.groups()
    number = default_port if port is None else int(port)
    return Address(protocol, host.strip("[]"), number, settings or "")


class RosEndpoint(NamedTuple):
    """The Zenoh router of a ROS 2 robot, and the form of its topics there."""

    endpoint: str
    rmw_zenoh: bool
    """Whether topics have the keys of rmw_zenoh, or plain ones (zenoh-bridge-ros2dds)."""
    domain: int
    namespace: str
    settings: dict[str, str]
    """Those beside rmw, domain and namespace."""


def parse_ros_endpoint(text: str, default_port: int) -> RosEndpoint | None:
    """Read ``ros2/tcp/HOST[:PORT][#rmw=zenoh&domain=N&namespace=NAME&...]``; None for another form."""
    where = parse_address(text.removeprefix(ROS2), default_port)
    if where is None or not text.startswith(ROS2):
        return None
    found = dict(item.partition("=")[::2] for item in where.settings.removeprefix("#").split("&") if item)
    rmw, domain = found.pop("rmw", "ros2dds"), read_domain(found.pop("domain", "0"))
    known = where.protocol in {"tcp", "tls", "quic"} and where.connectable and rmw in {"zenoh", "ros2dds"}
    if not known or domain is None:
        return None
    namespace = found.pop("namespace", "").strip("/")
    return RosEndpoint(str(where._replace(settings="")), rmw == "zenoh", domain, namespace, found)


def read_domain(value: str) -> int | None:
    """Read a ROS domain; None if it is none."""
    return int(value) if value.isascii() and value.isdigit() and int(value) <= MAX_DOMAIN else None
