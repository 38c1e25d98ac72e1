"""Files that are found by name, read with clear errors and never left half-written."""

import os
import tempfile
from importlib import resources
from pathlib import Path

from rover_ncp.core.errors import FileError

__all__ = ["read_bytes", "read_text", "resolve", "shipped_names", "write_atomic"]

_DATA = resources.files("rover_ncp") / "data"


def shipped_names(kind: str) -> list[str]:
    """Return the names of the shipped files of a kind (``courses``, ``policies``, ``circuits``)."""
    return sorted(
        item.name.removesuffix(".yaml") for item in (_DATA / kind).iterdir() if item.name.endswith(".yaml")
    )


def resolve(kind: str, name_or_path: str | Path) -> Path:
    """Find a shipped file by its bare name, or a file by its path.

    A bare name has neither a separator nor a suffix. Raises FileError when there is no such file.
    """
    text = str(name_or_path)
    if "/" not in text and not Path(text).suffix:
        shipped = Path(str(_DATA / kind / f"{text}.yaml"))
        if shipped.is_file():
            return shipped
        if not Path(text).is_file():
            shipped_list = ", ".join(shipped_names(kind))
            raise FileError(f"{text}: no such file, and none of the shipped {kind} ({shipped_list})")
    path = Path(text)
    if not path.is_file():
        raise FileError(f"{path}: no such file")
    return path


def read_bytes(path: Path) -> bytes:
    """Read a file; an unreadable one is a FileError."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def read_text(path: Path) -> str:
    """Read a UTF-8 file; an unreadable one, or one with other bytes, is a FileError."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error


def write_atomic(path: Path, content: bytes | str, private: bool = False) -> None:
    """Write a file whole or not at all: a temporary file beside it, synced, then renamed over it.

    A ``private`` one is its owner's alone. Makes missing folders. Raises FileError when the place cannot be
    written.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if not private:
                # mkstemp makes private files; what we ship to users follows their umask as any file would.
                umask = os.umask(0)
                os.umask(umask)
                Path(temporary).chmod(0o666 & ~umask)
            Path(temporary).replace(path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error
