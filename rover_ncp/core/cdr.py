"""ROS 2 messages to CDR bytes and back, with rosbags' tables of the types of ROS 2 Jazzy.

Nothing but FormatError leaves `decode`, whatever the bytes; no length inside them is believed before it is
held against the bytes that are there. The tables load on first use: reading a key table needs none of them.
"""

import functools
import struct
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from rover_ncp.core.errors import FormatError


@functools.cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def make(ros_type: str, **fields: Any) -> Any:
    """Return a message object of a type such as ``nav_msgs/msg/Odometry``.

    Arrays of numbers must be numpy arrays of the field's type. KeyError for a type that ROS does not have.
    """
    return _store().types[ros_type](**fields)


def encode(message: Any) -> bytes:
    """Return a message as little-endian CDR with its 4-byte header. Raises FormatError."""
    try:
        return bytes(_store().serialize_cdr(message, message.__msgtype__, little_endian=True))
    except (SerdeError, struct.error, OverflowError) as error:
        raise FormatError(f"cannot be written as CDR: {error}") from error


def decode(ros_type: str, data: bytes, max_bytes: int = 1 << 20) -> Any:
    """Read CDR bytes, of either byte order, as a message of ``ros_type``.

    Values are as they came: they may be NaN or infinite. Raises FormatError for anything that is not such a
    message, or is longer than ``max_bytes``.
    """
    if len(data) > max_bytes:
        raise FormatError(f"not {ros_type}: {len(data)} bytes, expected at most {max_bytes}")
    try:
        return _store().deserialize_cdr(data, ros_type)
    except SerdeError as error:
        raise FormatError(f"not {ros_type}: {error}") from error


@functools.cache
def definition(ros_type: str) -> str:
    """Return the .msg text of a type and all it is made of, as an MCAP ``ros2msg`` schema wants it."""
    return str(_store().generate_msgdef(ros_type, ros_version=2)[0])


@functools.cache
def type_hash(ros_type: str) -> str:
    """Return the type's hash as ROS 2 writes it into graph tokens: ``RIHS01_…`` (REP-2011)."""
    return str(_store().hash_rihs01(ros_type))
