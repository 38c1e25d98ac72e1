"""Records of an MCAP file, one after another: memory does not grow with the length of the file.

Each record is read whole before it is parsed, and a chunk is unpacked no further than its header says. So a
damaged or hostile file costs no more memory than `RECORD_LIMIT`. Specification: https://mcap.dev/spec.
"""

import io
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, McapRecord, Message, Metadata, Schema
from zstandard import ZstdDecompressor, ZstdError

from rover_ncp.core.errors import FileError

MAGIC = b"\x89MCAP0\r\n"
RECORD_LIMIT = 64 << 20
"""Largest record, and largest unpacked chunk, in bytes. Chunks of common writers have at most 4 MiB."""
UNPACKED_LIMIT, MAX_RATIO = 1 << 30, 100
"""Limits of a whole file: unpacked bytes, or for long files the ratio of unpacked to packed bytes. Recordings
of robots have a ratio of 3 to 20."""
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


class Damaged(Exception):
    """The records end before the file does; those that were read before it are sound."""


class _WholeReads(io.BytesIO):
    """The body of a record; a read past its end is an error."""

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if size is None or size < 0 or len(data) < size:
            raise ValueError("a length in the record is wrong")
        return data


_READERS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
}
"""Parsers of the records in use, messages aside. Indices are skipped."""
_DAMAGE = (McapError, ZstdError, struct.error, KeyError, ValueError, RuntimeError, OverflowError)


def read_records(path: Path, file: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of an open file; those of a chunk in place of the chunk.

    Raises Damaged where the file is cut off or damaged, FileError if it is too large or no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    limit, unpacked = max(UNPACKED_LIMIT, MAX_RATIO * size), 0
    for opcode, body, checksum in _bodies(path, file, size):
        try:
            record = _parsed(opcode, body)
            if isinstance(record, DataEnd) and record.data_section_crc not in {0, checksum}:
                raise ValueError("the checksum of all data differs")
            if isinstance(record, Chunk):
                if record.uncompressed_size > RECORD_LIMIT:
                    what = f"a chunk that unpacks to {record.uncompressed_size} bytes"
                    raise _too_large(path, what, RECORD_LIMIT)
                data = _unpacked(record)
                unpacked += len(data)
                if unpacked > limit:
                    raise _too_large(path, f"more than {limit} bytes, unpacked", limit)
                yield from _inside(data)
            elif record is not None:
                yield record
        except _DAMAGE as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise Damaged(f"damaged before byte {file.tell()}: {reason}") from error


def _bodies(path: Path, file: IO[bytes], size: int) -> Iterator[tuple[int, bytes, int]]:
    """Yield each record's opcode and body, and the checksum of all before it. Raises as `read_records`."""
    magic = file.read(len(MAGIC))
    if not magic:
        raise FileError(f"{path}: the file is empty")
    if not MAGIC.startswith(magic):
        raise FileError(f"{path}: not an MCAP recording")
    checksum, opcode = zlib.crc32(magic), 0
    while opcode != Opcode.FOOTER:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damaged(f"cut off at byte {size}")
        opcode, length = _HEAD.unpack(head)
        beyond = length > size - file.tell()
        if not opcode or (beyond and length > RECORD_LIMIT):
            raise Damaged(f"damaged before byte {file.tell()}: no such record")
        if beyond:
            raise Damaged(f"cut off at byte {size}")
        if length > RECORD_LIMIT:
            raise _too_large(path, f"a record of {length} bytes", RECORD_LIMIT)
        body = file.read(length)
        yield opcode, body, checksum
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
    end = file.read(len(MAGIC) + 1)
    if end != MAGIC:
        cut = f"cut off at byte {size}"
        raise Damaged(cut if MAGIC.startswith(end) else f"damaged before byte {file.tell()}: not the end")


def _too_large(path: Path, what: str, limit: int) -> FileError:
    return FileError(f"{path}: holds {what}; at most {limit} bytes are read")


def _parsed(opcode: int, body: bytes) -> McapRecord | None:
    """Return a record; None for one that is not in use."""
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        return Message(channel, log_ns, body[_MESSAGE.size :], publish_ns, sequence)
    read = _READERS.get(opcode)
    if read is None:
        return None
    if opcode == Opcode.ATTACHMENT and body[-4:] not in {
        bytes(4),
        zlib.crc32(body[:-4]).to_bytes(4, "little"),
    }:
        raise ValueError("the checksum of an attachment differs")
    return read(ReadDataStream(_WholeReads(body)))


def _inside(data: bytes) -> Iterator[McapRecord]:
    """Yield the records of an unpacked chunk."""
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size + length
        if at > len(data):
            raise ValueError("a record ends after its chunk")
        record = _parsed(opcode, data[at - length : at])
        if isinstance(record, Schema | Channel | Message):
            yield record


def _unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk as bytes. Raises one of _DAMAGE."""
    size, data = chunk.uncompressed_size, chunk.data
    if chunk.compression == "zstd":
        data = ZstdDecompressor().stream_reader(data).read(size + 1)
    elif chunk.compression == "lz4":
        decompressor: Any = lz4.frame.LZ4FrameDecompressor()
        data = decompressor.decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"unknown compression {chunk.compression[:20]!r}")
    if len(data) != size:
        raise ValueError("the size of a chunk differs from its header")
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise ValueError("the checksum of a chunk differs")
    return data
