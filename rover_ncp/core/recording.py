"""Recordings: MCAP files of the ros2 profile that hold the CDR bytes as they went over the wire.

Written so that a killed process loses little: attachments (policy, configuration, course) come first, and
what came since is a finished chunk on the disk after each `RecordingWriter.flush`. Read so that a file cut
off anywhere still gives all its whole records. Specification: https://mcap.dev/spec and /spec/registry.
"""

import contextlib
import fcntl
import functools
import io
import struct
import time
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple, Self

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from zstandard import ZstdError

from rover_ncp.core.cdr import definition
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import create, read_bytes, write_atomic

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 256 * 1024
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json", ".bnn": "text/plain"}
# A Header begins with its stamp, right behind CDR's own four bytes: int32 seconds, uint32 nanoseconds.
CDR_ORDERS = (b"\x00\x00", b"\x00\x01")
CDR_STAMP, CDR_STAMP_BIG = struct.Struct("<iI"), struct.Struct(">iI")
RECORD_LIMIT = 1 << 30
"""Our records are far shorter; a longer one means a damaged length."""


class Layout(NamedTuple):
    """Encoding of a channel's bytes as its file declares it: MCAP's Channel, with its Schema."""

    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None
    """Name, encoding and text; None where a channel needs none."""


@dataclass(frozen=True)
class Recorded:
    """One message: its bytes, when it arrived here and when it was sent (ns since the epoch)."""

    topic: str
    type: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int = 0
    layout: Layout | None = field(default=None, compare=False, repr=False)
    """None for ours: ``type`` in CDR. A file may hold what we cannot read; `rewrite` keeps it as it is."""


@dataclass(frozen=True)
class Recording:
    """A whole file in memory; ``complete`` is False when its writer never finished it."""

    path: Path
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
    messages: tuple[Recorded, ...]
    complete: bool
    profile: str = "ros2"

    def topic(self, name: str) -> list[Recorded]:
        """Return the messages of one topic in the order in which they were written."""
        return [message for message in self.messages if message.topic == name]

    def attachment(self, name: str) -> bytes:
        """Return an attachment. Raises FileError when the file does not hold it."""
        if name not in self.attachments:
            held = ", ".join(self.attachments) or "none"
            raise FileError(f"{self.path}: has no attachment {name} (it has: {held})")
        return self.attachments[name]


@functools.cache
def _begins_with_header(ros_type: str) -> bool:
    fields = [line for line in definition(ros_type).splitlines() if line and not line.startswith("#")]
    return fields[0].split() == ["std_msgs/Header", "header"]


def header_stamp_ns(ros_type: str, data: bytes) -> int | None:
    """Return the stamp of a message whose first field is a Header; None when there is none to read."""
    if not _begins_with_header(ros_type) or len(data) < CDR_STAMP.size + 4 or data[:2] not in CDR_ORDERS:
        return None
    seconds, nanoseconds = (CDR_STAMP if data[1] else CDR_STAMP_BIG).unpack_from(data, 4)
    return int(seconds * 1_000_000_000 + nanoseconds)


@functools.cache
def _our_layout(ros_type: str) -> Layout:
    # The key must be there (MCAP registry, ros2 profile); what it would say is known to ROS alone.
    metadata = (("offered_qos_profiles", ""),)
    return Layout("cdr", metadata, (ros_type, "ros2msg", definition(ros_type).encode()))


class RecordingWriter:
    """Writes one file. Not for two threads at once; a failing disk shows as OSError from any method.

    Raises FileError for a path where a file exists, unless ``overwrite``, or where none can be made.
    """

    def __init__(
        self, target: Path | IO[bytes], *, overwrite: bool = False, profile: str = Recording.profile
    ) -> None:
        if isinstance(target, Path):
            self._file = create(target, overwrite=overwrite)
            with contextlib.suppress(OSError):  # a file system without locks can be written all the same
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # see require_finished
        else:
            self._file = target
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES)
        self._writer.start(profile=profile, library="rover-ncp")
        self._channels: dict[tuple[str, Layout | None], tuple[int, str]] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        """Add a message. A topic of ours has one type; ValueError if another comes on it."""
        known = (message.topic, message.layout)
        if known not in self._channels:
            layout = message.layout or _our_layout(message.type)
            self._channels[known] = (self._channel(message.topic, layout), message.type)
        channel, ros_type = self._channels[known]
        if ros_type != message.type:
            raise ValueError(f"{message.topic} holds {ros_type}, not {message.type}")
        self._writer.add_message(
            channel, message.log_ns, message.data, message.publish_ns, message.sequence % 2**32
        )

    def _channel(self, topic: str, layout: Layout) -> int:
        schema = layout.schema
        if schema is not None and schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(*schema)
        number = 0 if schema is None else self._schemas[schema]  # 0: MCAP's for none
        return self._writer.register_channel(topic, layout.encoding, number, dict(layout.metadata))

    def flush(self) -> None:
        """Put everything so far on the disk as whole records (but do not wait for the disk itself)."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap has it untyped

    def close(self) -> None:
        """Finish the file with its index, and close it."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, after a method failed; what was flushed can be read."""
        with contextlib.suppress(OSError):
            self._file.close()


class _WholeReads(io.BytesIO):
    """A file in memory that never returns fewer bytes than asked for: the end of it is an error."""

    def read(self, size: int | None = -1) -> bytes:
        if size is not None and size > self.getbuffer().nbytes:
            raise EndOfFile  # also a damaged length that is no size at all
        data = super().read(size)
        if size is not None and 0 <= len(data) < size:
            raise EndOfFile
        return data


def read_recording(path: Path) -> Recording:
    """Read a recording, also one whose writer was killed. Raises FileError: unreadable, or damaged."""
    content = read_bytes(path)
    if not content:
        raise FileError(f"{path}: the file is empty")
    if not content.startswith(MAGIC[: len(content)]):
        raise FileError(f"{path}: not an MCAP recording")
    stream = _WholeReads(content)
    schemas: dict[int, tuple[str, str, bytes]] = {}
    channels: dict[int, tuple[str, str, Layout]] = {}
    profile = ""
    attachments: dict[str, bytes] = {}
    metadata: dict[str, dict[str, str]] = {}
    messages: list[Recorded] = []
    complete = headed = False
    reader = StreamReader(stream, validate_crcs=True, record_size_limit=RECORD_LIMIT)
    try:
        for record in reader.records:
            if isinstance(record, Message):
                topic, ros_type, layout = channels[record.channel_id]
                times = record.log_time, record.publish_time
                messages.append(Recorded(topic, ros_type, record.data, *times, record.sequence, layout))
            elif isinstance(record, Schema):
                schemas[record.id] = (record.name, record.encoding, record.data)
            elif isinstance(record, Channel):
                schema = schemas.get(record.schema_id)
                layout = Layout(record.message_encoding, tuple(record.metadata.items()), schema)
                channels[record.id] = (record.topic, schema[0] if schema else "", layout)
            elif isinstance(record, Attachment):
                attachments[record.name] = record.data
            elif isinstance(record, Metadata):
                metadata[record.name] = record.metadata
            elif isinstance(record, Header):
                headed, profile = True, record.profile
        complete = True
    except EndOfFile:
        if not headed:
            raise FileError(f"{path}: cut off before its first record") from None
    except _DAMAGE as error:
        raise FileError(f"{path}: damaged before byte {stream.tell()}: {error or 'bad record'}") from error
    return Recording(path, attachments, metadata, tuple(messages), complete, profile)


_DAMAGE = (
    McapError,
    ZstdError,
    struct.error,
    zlib.error,
    UnicodeDecodeError,
    KeyError,
    ValueError,
    RuntimeError,
)


def require_finished(path: Path) -> None:
    """Raise FileError if a process still writes this recording, or if it cannot be read."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise FileError(f"{path}: another process is writing it; wait for its end") from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def rewrite(source: Recording, target: Path, more: Iterable[Recorded] = ()) -> None:
    """Write a whole, indexed copy of a recording, with ``more`` messages put in at their time.

    Makes a cut-off recording whole, and adds topics such as ``truth/pose``. ``target`` may be the source's
    own file: it is replaced at once or not at all. Raises FileError.
    """
    buffer = io.BytesIO()
    buffer.close = lambda: None  # type: ignore[method-assign]  # the writer closes what we still have to read
    with RecordingWriter(buffer, profile=source.profile) as writer:
        for name, content in source.attachments.items():
            writer.attach(name, content)
        for name, values in source.metadata.items():
            writer.describe(name, values)
        for message in sorted([*source.messages, *more], key=lambda message: message.log_ns):
            writer.write(message)
    write_atomic(target, buffer.getvalue())
