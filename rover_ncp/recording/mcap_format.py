"""Records of an MCAP file, one after another, by the mcap library's reader for streams.

That reader bounds only the length that a record states. A length within a record, and the size of an unpacked
chunk, are bounded here: recordings of strangers are read. Specification: https://mcap.dev/spec.
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, cast

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError, RecordLengthLimitExceeded
from mcap.records import Attachment, Chunk, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk
from zstandard import ZstdDecompressor, ZstdError

from rover_ncp.core.errors import FileError

MAGIC = b"\x89MCAP0\r\n"
RECORD_LIMIT = 64 << 20
"""Largest record, and largest unpacked chunk, in bytes. Chunks of common writers have at most 4 MiB."""
MAX_RATIO = 100
"""Largest ratio of unpacked to packed bytes of a file that unpacks to more than `RECORD_LIMIT`. Recordings of
robots have a ratio of 2 to 20."""
_DAMAGE = (McapError, ZstdError, struct.error, KeyError, ValueError, RuntimeError, OverflowError)


class Damaged(Exception):
    """The records end before the file does; those that were read before it are sound."""


class _CutOffError(Exception):
    """The file ends within a record."""


class _WholeReads:
    """An open file of which each read is whole, or an error."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.newest = b""
        """What the newest read returned."""

    def read(self, size: int) -> bytes:
        if not 0 <= size <= RECORD_LIMIT:
            raise ValueError("a length in the record is wrong")
        self.newest = self._file.read(size)
        if len(self.newest) < size:
            raise _CutOffError
        return self.newest


def read_records(path: Path, file: IO[bytes]) -> Iterator[McapRecord]:
    """Yield the records of an open file; those of a chunk in place of the chunk.

    Raises Damaged where the file is cut off or damaged, FileError if it is too large or no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    magic = file.read(len(MAGIC))
    if not magic:
        raise FileError(f"{path}: the file is empty")
    if not MAGIC.startswith(magic):
        raise FileError(f"{path}: not an MCAP recording")
    file.seek(0)
    source = _WholeReads(file)
    reader = StreamReader(
        cast(IO[bytes], source), emit_chunks=True, validate_crcs=True, record_size_limit=RECORD_LIMIT
    )
    limit, unpacked = max(RECORD_LIMIT, MAX_RATIO * size), 0
    try:
        for record in reader.records:
            if isinstance(record, Attachment) and source.newest not in {bytes(4), _checksum(record)}:
                raise ValueError("the checksum of an attachment differs")
            if not isinstance(record, Chunk):
                yield record
                continue
            if record.uncompressed_size > RECORD_LIMIT:
                what = f"a chunk that unpacks to {record.uncompressed_size} bytes"
                raise _too_large(path, what, RECORD_LIMIT)
            plain = replace(record, compression="", data=_unpacked(record))
            unpacked += len(plain.data)
            if unpacked > limit:
                raise _too_large(path, f"more than {limit} bytes, unpacked", limit)
            yield from breakup_chunk(plain, validate_crc=True)
        if file.read(1):
            raise ValueError("the file goes on after its end")
    except _CutOffError as error:
        raise Damaged(f"cut off at byte {size}") from error
    except _DAMAGE as error:
        if isinstance(error, RecordLengthLimitExceeded) and size - file.tell() > RECORD_LIMIT:
            raise _too_large(path, f"a larger record before byte {file.tell()}", RECORD_LIMIT) from error
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise Damaged(f"damaged before byte {file.tell()}: {reason}") from error


def _checksum(attachment: Attachment) -> bytes:
    """Return the last bytes of an attachment's record."""
    builder = RecordBuilder()
    attachment.write(builder)
    return bytes(builder.end()[-4:])  # type: ignore[no-untyped-call]


def _too_large(path: Path, what: str, limit: int) -> FileError:
    return FileError(f"{path}: holds {what}; at most {limit} bytes are read")


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
    return data
