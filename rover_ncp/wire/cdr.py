"""ROS 2 messages to CDR bytes and back, with rosbags' tables of the types of ROS 2 Jazzy.

Nothing but FormatError leaves `decode`, whatever the bytes; no length inside them is believed before it is
held against the bytes that are there. The tables load on first use: reading a key table needs none of them.
"""

import functools
import struct
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rover_ncp.core.errors import FormatError

_FOXGLOVE = "foxglove_msgs/msg/"
_OTHERS = {
    "irobot_create_msgs/msg/DockStatus": "std_msgs/Header header\nbool dock_visible\nbool is_docked\n",
    "irobot_create_msgs/msg/HazardDetection": "std_msgs/Header header\nuint8 type\n",
    "irobot_create_msgs/msg/HazardDetectionVector": (
        "std_msgs/Header header\nirobot_create_msgs/HazardDetection[] detections\n"
    ),
    f"{_FOXGLOVE}Point2": "float64 x\nfloat64 y\n",
    f"{_FOXGLOVE}Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a\n",
    f"{_FOXGLOVE}CircleAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nfloat64 diameter\n"
        "float64 thickness\nfoxglove_msgs/Color fill_color\nfoxglove_msgs/Color outline_color\n"
    ),
    f"{_FOXGLOVE}PointsAnnotation": (
        "builtin_interfaces/Time timestamp\nuint8 type\nfoxglove_msgs/Point2[] points\n"
        "foxglove_msgs/Color outline_color\nfoxglove_msgs/Color[] outline_colors\n"
        "foxglove_msgs/Color fill_color\nfloat64 thickness\n"
    ),
    f"{_FOXGLOVE}TextAnnotation": (
        "builtin_interfaces/Time timestamp\nfoxglove_msgs/Point2 position\nstring text\n"
        "float64 font_size\nfoxglove_msgs/Color text_color\nfoxglove_msgs/Color background_color\n"
    ),
    f"{_FOXGLOVE}ImageAnnotations": (
        "foxglove_msgs/CircleAnnotation[] circles\nfoxglove_msgs/PointsAnnotation[] points\n"
        "foxglove_msgs/TextAnnotation[] texts\n"
    ),
}
"""Types that are not ROS's own."""


@functools.cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _OTHERS.items():
        store.register(get_types_from_msg(text, name))
    return store


def encode(ros_type: str, **fields: Any) -> bytes:
    """Return a message as little-endian CDR with its 4-byte header. Raises FormatError.

    A message within it is a dict of its fields, an array of numbers a numpy array of the field's type. Fields
    that are left out are 0, false or empty.
    """
    try:
        return bytes(_store().serialize_cdr(_message(ros_type, fields), ros_type, little_endian=True))
    except (SerdeError, struct.error, OverflowError) as error:
        raise FormatError(f"cannot be written as CDR: {error}") from error


def _message(ros_type: str, fields: Mapping[str, Any]) -> Any:
    kind, defaults, makers = _parts(ros_type)
    values = {**defaults, **fields}
    for name, make in makers.items():
        if name in fields:
            values[name] = make(fields[name])
    return kind(**values)


@functools.cache
def _parts(ros_type: str) -> tuple[Callable[..., Any], dict[str, Any], dict[str, Callable[[Any], Any]]]:
    """Return a type, the defaults of its fields, and the makers of those that are messages themselves."""
    definitions: Any = _store().fielddefs[ros_type][1]
    defaults: dict[str, Any] = {}
    makers: dict[str, Callable[[Any], Any]] = {}
    for name, (kind, of) in definitions:
        if kind == Nodetype.NAME:
            defaults[name], makers[name] = _message(of, {}), functools.partial(_message, of)
        elif kind == Nodetype.BASE:
            defaults[name] = "" if of[0] == "string" else 0
        elif of[0][0] == Nodetype.NAME:
            defaults[name], makers[name] = [], functools.partial(_messages, of[0][1])
        else:
            defaults[name] = np.zeros(of[1], of[0][1][0])
    return _store().types[ros_type], defaults, makers


def _messages(ros_type: str, items: Iterable[Mapping[str, Any]]) -> list[Any]:
    return [_message(ros_type, item) for item in items]


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


def is_known(ros_type: str) -> bool:
    """Whether messages of this type can be written and read."""
    return ros_type in _store().fielddefs


@functools.cache
def definition(ros_type: str) -> str:
    """Return the .msg text of a type and all it is made of, as an MCAP ``ros2msg`` schema wants it."""
    return str(_store().generate_msgdef(ros_type, ros_version=2)[0])


@functools.cache
def type_hash(ros_type: str) -> str:
    """Return the type's hash as ROS 2 writes it into graph tokens: ``RIHS01_…`` (REP-2011)."""
    return str(_store().hash_rihs01(ros_type))
