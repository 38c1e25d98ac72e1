"""Recordings: MCAP files of the ros2 profile that hold the CDR bytes as they went over the wire.

Written so that a killed process loses little: attachments (policy, configuration, course) come first, and
what came since is a finished chunk on the disk after each `RecordingWriter.flush`. A file that is cut off or
damaged is read up to there. Specification: https://mcap.dev/spec and /spec/registry.
"""

import contextlib
import fcntl
import heapq
import logging
import os
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Self

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import Writer
from pydantic import BaseModel, Field

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import create, open_file, write_atomic
from rover_ncp.recording.mcap_format import Damaged, read_records
from rover_ncp.recording.recorded import Recorded, header_stamp_ns, steady
from rover_ncp.wire.cdr import definition, is_known
from rover_ncp.wire.key_table import KEYS

__all__ = [
    "Recorded",
    "Recording",
    "RecordingWriter",
    "Recovery",
    "header_stamp_ns",
    "read_recording",
    "recover",
    "require_finished",
    "rewrite",
]

_log = logging.getLogger(__name__)
CHUNK_BYTES = 256 * 1024
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json"}
MAX_TIME_NS = (1 << 64) - 1
MAX_NAME = 1000
"""Characters of the name of a topic or type; ROS has 255 at most."""
MEMORY_LIMIT, MESSAGE_BYTES = 1 << 30, 250
"""Limit of what `read_recording` keeps, and memory of a message beside its data, in bytes. Five hours of what
a report reads come to the limit."""


@dataclass(frozen=True)
class Recording:
    """A whole file in memory; ``complete`` is False if it is cut off or damaged, ``damage`` says where."""

    path: Path
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
    messages: tuple[Recorded, ...]
    complete: bool
    damage: str = ""

    def topic(self, name: str) -> list[Recorded]:
        """Return the messages of one topic in the order in which they were written."""
        return [message for message in self.messages if message.topic == name]

    def attachment(self, name: str) -> bytes:
        """Return an attachment. Raises FileError when the file does not hold it."""
        if name not in self.attachments:
            held = ", ".join(self.attachments) or "none"
            raise FileError(f"{self.path}: has no attachment {name} (it has: {held})")
        return self.attachments[name]


# rosbag2 replays a topic as it was offered. Numbers are those of metadata before version 9, which all its
# versions read beside the record that says so (`Metadata("rosbag2", ...)`).
_FOREVER = "{sec: 9223372036, nsec: 854775807}"
_LATCHED_QOS = f"""- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {_FOREVER}
  lifespan: {_FOREVER}
  liveliness: 1
  liveliness_lease_duration: {_FOREVER}
  avoid_ros_namespace_conventions: false
"""
"""Keep the last message, reliable, transient local: late subscribers receive it."""
_ROSBAG2 = "rosbag2", {"serialized_metadata": ""}
_LATCHED = {row.name for row in KEYS if row.latched} | {"deploy/frames", "deploy/path"}
"""Topics of which one message counts for the whole recording."""


class RecordingWriter:
    """Writes one file. Not for two threads at once; a failing disk shows as OSError from any method.

    Raises FileError for a path where a file exists, or where none can be made.
    """

    def __init__(self, target: Path | IO[bytes]) -> None:
        self._owns = isinstance(target, Path)
        if isinstance(target, Path):
            self._file = create(target)
            with contextlib.suppress(OSError):  # a file system without locks can be written all the same
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # see require_finished
        else:
            self._file = target
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="ros2", library="rover-ncp")
        self._channels: dict[str, tuple[int, str]] = {}
        self._schemas: dict[str, int] = {}
        self._latched = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is None:
            self.close()
        else:
            self.abandon()

    def attach(self, name: str, content: bytes) -> None:
        """Add a file; meant for before the first message, so that it survives a crash."""
        now = time.time_ns()
        media_type = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
        self._writer.add_attachment(now, now, name, media_type, content)

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Add a record of metadata."""
        self._writer.add_metadata(name, dict(values))

    def write(self, message: Recorded) -> None:
        """Add a message.

        Raises ValueError for a type that is not known or not its topic's first, and for a time that MCAP does
        not have. The file is not changed then.
        """
        # The library fails in the middle of a record, and so would damage the file.
        if not (0 <= message.log_ns <= MAX_TIME_NS and 0 <= message.publish_ns <= MAX_TIME_NS):
            times = f"{message.log_ns} ns and {message.publish_ns} ns"
            raise ValueError(f"{message.topic} has the times {times}, expected 0 to 2^64 - 1")
        if message.topic not in self._channels:
            if not is_known(message.type):
                found = f"the type {message.type}" if message.type else "no CDR"
                raise ValueError(f"{message.topic} has {found}, which rover-ncp does not write")
            if message.topic in _LATCHED and not self._latched:
                self._latched = True
                self.describe(*_ROSBAG2)
            self._channels[message.topic] = (self._channel(message.topic, message.type), message.type)
        channel, ros_type = self._channels[message.topic]
        if ros_type != message.type:
            raise ValueError(f"{message.topic} has two types, {ros_type} and {message.type}")
        self._writer.add_message(
            channel, message.log_ns, message.data, message.publish_ns, message.sequence % 2**32
        )

    def _channel(self, topic: str, ros_type: str) -> int:
        if ros_type not in self._schemas:
            text = definition(ros_type).encode()
            self._schemas[ros_type] = self._writer.register_schema(ros_type, "ros2msg", text)
        # The key must be there (MCAP registry, ros2 profile).
        metadata = {"offered_qos_profiles": _LATCHED_QOS if topic in _LATCHED else ""}
        return self._writer.register_channel(topic, "cdr", self._schemas[ros_type], metadata)

    def flush(self) -> None:
        """Put everything so far into the file as whole records, for other processes to read."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap has it untyped
        self._file.flush()

    def sync(self) -> None:
        """Flush, and wait until the disk holds it, so that it survives a power cut."""
        self.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Finish the file with its index; sync and close it, unless it was given open."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        if self._owns:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, after a method failed; what was flushed can be read."""
        if self._owns:
            with contextlib.suppress(OSError):
                self._file.close()


Content = Recorded | Attachment | Metadata


def _contents(path: Path) -> Iterator[Content]:
    """Yield what a file holds. Raises Damaged at the end of what can be read; FileError."""
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    headed = False
    try:
        with open_file(path) as file:
            for record in read_records(path, file):
                headed = headed or isinstance(record, Header)
                if isinstance(record, Message):
                    if record.channel_id not in channels:
                        raise Damaged("damaged: a message of an unknown channel")
                    times = record.log_time, record.publish_time
                    yield Recorded(*channels[record.channel_id], record.data, *times, record.sequence)
                elif isinstance(record, Schema):
                    schemas[record.id] = _short(record.name)
                elif isinstance(record, Channel):
                    is_cdr = record.message_encoding == "cdr" and record.schema_id in schemas
                    channels[record.id] = (_short(record.topic), schemas[record.schema_id] if is_cdr else "")
                elif isinstance(record, Attachment | Metadata):
                    yield record
    except Damaged as damage:
        if not headed:
            found = "cut off" if str(damage).startswith("cut off") else str(damage)
            raise FileError(f"{path}: {found} before its first record") from damage
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def _short(name: str) -> str:
    """Return the name of a topic or type. Raises Damaged for one that no message could show."""
    if len(name) > MAX_NAME:
        raise Damaged(f"damaged: a name of {len(name)} characters, expected {MAX_NAME} at most")
    return name


def read_recording(
    path: Path, topics: Collection[str] | None = None, *, types: Collection[str] = ()
) -> Recording:
    """Read a recording, or the messages of some topics or ROS types.

    Of a cut or damaged one what precedes the damage is read.

    The log gets one line about damage. Raises FileError: unreadable, no recording, or larger than
    `MEMORY_LIMIT`.
    """
    damage = ""
    attachments: dict[str, bytes] = {}
    metadata: dict[str, dict[str, str]] = {}
    messages: list[Recorded] = []
    kept = 0
    try:
        for item in _contents(path):
            if isinstance(item, Recorded):
                if topics is not None and item.topic not in topics and item.type not in types:
                    continue
                messages.append(item)
                kept += len(item.data) + MESSAGE_BYTES
            elif isinstance(item, Attachment):
                attachments[item.name] = item.data
                kept += len(item.data) + MESSAGE_BYTES
            else:
                metadata[item.name] = item.metadata
                kept += (1 + len(item.metadata)) * MESSAGE_BYTES
            if kept > MEMORY_LIMIT:
                raise FileError(f"{path}: holds more than the limit of {MEMORY_LIMIT >> 20} MiB of messages")
    except Damaged as error:
        damage = str(error)
        _log.warning("%s: %s; what precedes it is used", path, damage)
    return Recording(path, attachments, metadata, tuple(messages), not damage, damage)


def require_finished(path: Path) -> None:
    """Raise FileError if a process still writes this recording, or if it cannot be read."""
    try:
        with open_file(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise FileError(f"{path}: another process is writing it; wait for its end") from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def rewrite(source: Recording, target: Path, more: Iterable[Recorded] = ()) -> None:
    """Write a whole, indexed copy of a recording, with ``more`` messages merged in, such as ``truth/pose``.

    Messages of the source keep their order. The log times of ``more`` rise, by a clock that was never set.
    ``target`` may be the source's own file: it is replaced at once or not at all. Raises FileError.
    """
    attachments = [Attachment(0, 0, name, "", content) for name, content in source.attachments.items()]
    metadata = [Metadata(name, dict(values)) for name, values in source.metadata.items()]
    own = zip((message.log_ns for message in steady(source.messages)), source.messages, strict=True)
    others = ((message.log_ns, message) for message in more)
    messages = (message for _, message in heapq.merge(own, others, key=lambda pair: pair[0]))
    _write_whole(source.path, target, chain(attachments, metadata, messages))


class Recovery(BaseModel):
    """Result of `recover`."""

    recording: str = Field(description="the file that is whole")
    was_complete: bool = Field(description="whether it was already")
    damage: str | None = Field(description="where it was cut off or damaged")
    messages: int = Field(description="how many")
    attachments: list[str] = Field(description="their names")
    seconds: float = Field(description="from the first message to the last")


def recover(path: Path, target: Path) -> Recovery:
    """Write a whole copy of a recording, in its order, unless it is whole and ``target`` is its own file.

    Memory does not grow with the length. Raises FileError, also for messages that rover-ncp does not write.
    """
    damage: list[str] = []
    attachments: list[str] = []

    def messages() -> Iterator[Recorded]:
        for item in _before_damage(path, damage):
            if isinstance(item, Recorded):
                yield item
            elif isinstance(item, Attachment):
                attachments.append(item.name)

    count, began_ns, ended_ns = 0, 0, 0
    for count, message in enumerate(steady(messages()), 1):
        began_ns, ended_ns = began_ns if count > 1 else message.log_ns, message.log_ns
    if damage or target != path:
        _write_whole(path, target, _before_damage(path, []))
    return Recovery(
        recording=str(target),
        was_complete=not damage,
        damage=damage[0] if damage else None,
        messages=count,
        attachments=sorted(attachments),
        seconds=(ended_ns - began_ns) * 1e-9,
    )


def _before_damage(path: Path, damage: list[str]) -> Iterator[Content]:
    """Yield what precedes the damage of a file, and append its description."""
    try:
        yield from _contents(path)
    except Damaged as error:
        damage.append(str(error))


def _write_whole(path: Path, target: Path, contents: Iterable[Content]) -> None:
    """Write what the recording at ``path`` holds. Raises FileError, also for types that are not known."""

    def fill(file: IO[bytes]) -> None:
        with RecordingWriter(file) as writer:
            for item in contents:
                if isinstance(item, Recorded):
                    writer.write(item)
                elif isinstance(item, Attachment):
                    writer.attach(item.name, item.data)
                elif item.name != _ROSBAG2[0]:  # the writer adds it
                    writer.describe(item.name, item.metadata)

    try:
        write_atomic(target, fill)
    except ValueError as error:
        raise FileError(f"{path}: {error}; 'mcap recover' repairs files of other software") from error
