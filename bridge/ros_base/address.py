"""The address of a ROS 2 robot: where its Zenoh router is, and in which form its topics are there."""

from dataclasses import dataclass

from bridge.ros.discovery import Convention
from bridge.transport import split_host
from rover_ncp.core.errors import UsageError

PREFIX = "ros2/"
_PORT = 7447
_FORM = (
    "expected ros2/tcp/HOST[:PORT], then #rmw=zenoh&domain=N for rmw_zenoh, &namespace=NAME for a namespace"
)
_MOST_DOMAIN = 232
"""The largest ROS_DOMAIN_ID whose ports DDS has."""


@dataclass(frozen=True)
class RosAddress:
    """``endpoint`` is a Zenoh endpoint; ``namespace`` is put before all topics."""

    endpoint: str
    convention: Convention = Convention.ROS2DDS
    domain: int = 0
    namespace: str = ""

    def topic(self, name: str) -> str:
        """Return a topic with the namespace, without a leading slash."""
        return f"{self.namespace}/{name}" if self.namespace else name


def parse_address(text: str) -> RosAddress:
    """Read ``ros2/tcp/HOST[:PORT][#rmw=zenoh&domain=N&namespace=NAME]``. Raises UsageError."""
    place, _, settings = text.removeprefix(PREFIX).partition("#")
    protocol, _, address = place.partition("/")
    host, port = split_host(address, _PORT)
    found = dict(item.partition("=")[::2] for item in settings.split("&") if item)
    rmw, domain = found.pop("rmw", "ros2dds"), found.pop("domain", "0")
    namespace = found.pop("namespace", "").strip("/")
    valid = (
        text.startswith(PREFIX)
        and protocol in {"tcp", "tls", "quic"}
        and host
        and port.isdigit()
        and 0 < int(port) < 65536
        and rmw in {"zenoh", "ros2dds"}
        and domain.isascii()
        and domain.isdigit()
        and int(domain) <= _MOST_DOMAIN
        and not found
    )
    if not valid:
        raise UsageError(f"base {text}: {_FORM}")
    convention = Convention.RMW_ZENOH if rmw == "zenoh" else Convention.ROS2DDS
    where = f"[{host}]" if ":" in host else host
    return RosAddress(f"{protocol}/{where}:{port}", convention, int(domain), namespace)
