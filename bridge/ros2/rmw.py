"""rmw_zenoh's form: keys of topics, tokens of its graph, the attachment of each message. Pure functions.

Form from rmw_zenoh (docs/design.md, liveliness_utils.cpp, attachment_helpers.cpp; facts only), as of ROS 2
Jazzy and later; Humble has no type hashes. The payloads are the plain keys' own.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

import xxhash

from bridge.ros2.discovery import Announced
from rover_ncp.core.errors import FormatError, UsageError
from rover_ncp.wire.address import MAX_DOMAIN, read_domain
from rover_ncp.wire.cdr import type_hash

NODE_NAME = "rover_bridge"
_NAMESPACE = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
# What differs from rmw_zenoh's defaults (reliable, volatile, keep the last 42, no deadlines):
# reliability:durability:history,depth:deadline:lifespan:liveliness.
_KEEP_10 = "::,10:,:,:,,"
_LATCHED = ":1:,1:,:,:,,"
"""Transient local, the last 1: as tf2 has tf_static."""
_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True)
class Topic:
    """A ROS topic without its leading slash, and a type such as ``nav_msgs/msg/Odometry``."""

    name: str
    ros_type: str
    latched: bool = False
    hashed: bool = True

    def key(self, domain: int) -> str:
        """Return the key its messages travel on."""
        return f"{domain}/{self.name}/{self.dds_type}/{self.hash}"

    @property
    def hash(self) -> str:
        """Return the type's hash, or what stands in its place in ROS 2 Humble."""
        return type_hash(self.ros_type) if self.hashed else "TypeHashNotSupported"

    @property
    def dds_type(self) -> str:
        """The type's name as ROS's C++ type support has it: ``nav_msgs::msg::dds_::Odometry_``."""
        *folders, name = self.ros_type.split("/")
        return "::".join([*folders, "dds_", f"{name}_"])


@dataclass(frozen=True)
class Graph:
    """One node of the ROS graph, on the Zenoh session ``zid``; ``namespace`` has no slashes around it.

    Raises UsageError for a namespace that ROS does not accept.
    """

    domain: int
    zid: str
    namespace: str = ""
    node: str = NODE_NAME

    def __post_init__(self) -> None:
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise UsageError(
                f"namespace {self.namespace!r}: expected names of letters, digits and _, joined by /, for ROS"
            )

    def node_token(self) -> str:
        """Return the token that stands for the node."""
        return self._token(0, "NN")

    def topic_token(self, number: int, topic: Topic, *, published: bool) -> str:
        """Return the token of a publisher or subscriber; ``number`` is its own among all of the session."""
        qos = _LATCHED if topic.latched else _KEEP_10
        where = self._token(number, "MP" if published else "MS")
        return f"{where}/{_mangled(topic.name)}/{topic.dds_type}/{topic.hash}/{qos}"

    def _token(self, number: int, kind: str) -> str:
        # Node 0 of the session, in the enclave "/".
        where = f"@ros2_lv/{self.domain}/{self.zid}/0/{number}"
        return f"{where}/{kind}/%/{_mangled(self.namespace)}/{self.node}"


class Attachment(NamedTuple):
    """The attachment of each message: 33 bytes, of which one is the length of ``gid``.

    ``sequence`` counts a publisher's messages from 1, ``stamp_ns`` is its wall clock when it sent this one,
    ``gid`` identifies the publisher.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return the bytes."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, len(self.gid), self.gid)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the bytes. Raises FormatError."""
        if len(data) != _ATTACHMENT.size or data[16] != 16:
            raise FormatError(f"not an attachment of rmw_zenoh: {len(data)} bytes")
        sequence, stamp_ns, _, gid_ = _ATTACHMENT.unpack(data)
        return cls(sequence, stamp_ns, gid_)


def read_token(token: str) -> Announced | None:
    """Return what a token of rmw_zenoh announces of a topic; None for other tokens."""
    match token.split("/"):
        case ["@ros2_lv", _, zid, _, _, "MP" | "MS" as kind, _, namespace, node, topic, dds_type, *_]:
            if "::" not in dds_type:
                return None
            *folders, _, last = dds_type.split("::")
            ros_type = "/".join([*folders, last.removesuffix("_")])
            who = f"{namespace}/{node}".replace("%", "/").replace("//", "/")
            name = topic.removeprefix("%").replace("%", "/")
            return Announced(zid, kind == "MP", name, ros_type, who, gid(token))
    return None


def gid(token: str) -> bytes:
    """Return the 16 bytes by which ROS identifies a publisher: the hash of its token, low half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


def domain_id(environment: Mapping[str, str]) -> int:
    """Return ROS_DOMAIN_ID, 0 without one. Raises UsageError for an invalid one."""
    value = environment.get("ROS_DOMAIN_ID") or "0"
    domain = read_domain(value)
    if domain is None:
        raise UsageError(f"ROS_DOMAIN_ID={value}: expected a number from 0 to {MAX_DOMAIN}")
    return domain


def _mangled(name: str) -> str:
    return f"/{name}".replace("/", "%")
