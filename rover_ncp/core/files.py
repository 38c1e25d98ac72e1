"""Files that are found by name, read with clear errors and never left half-written."""

import codecs
import contextlib
import errno
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import IO

from rover_ncp.core.errors import FileError

_DATA = resources.files("rover_ncp") / "data"


MAX_BYTES = 64 << 20
"""Limit of a file that is read as a whole; recordings have limits of their own."""
DEFAULT_ROBOT = "p3at-sh"
"""The robot that courses and policies were made for: the description in use unless another is named."""


def shipped_names(kind: str) -> list[str]:
    """Return the names of the shipped files of a kind (``courses``, ``policies``, ``circuits``)."""
    return sorted(
        item.name.removesuffix(".yaml") for item in (_DATA / kind).iterdir() if item.name.endswith(".yaml")
    )


def resolve(kind: str, name_or_path: str | Path, folder: Path = Path()) -> Path:
    """Find a shipped file by its bare name, or a file by its path from ``folder``.

    A bare name has neither a separator nor a suffix. A file that names another one passes its own folder.
    Raises FileError when there is no such file.
    """
    text = str(name_or_path)
    if not text:
        raise FileError(f"an empty name, expected a file or one of the shipped {kind}")
    if "/" not in text and not Path(text).suffix:
        shipped = shipped_names(kind)
        if text in shipped:
            return Path(str(_DATA / kind / f"{text}.yaml"))
        if not _exists(folder / text):
            raise FileError(f"{text}: no such file, and none of the shipped {kind} ({', '.join(shipped)})")
    return existing_file(folder / text)


def existing_file(path: Path) -> Path:
    """Return the path of a file. Raises FileError: there is none, it is a folder, it cannot be looked up."""
    if not _exists(path):
        raise FileError(f"{path}: no such file")
    if not path.is_file():
        raise FileError(f"{path}: is {'a folder' if path.is_dir() else 'a device or pipe'}, expected a file")
    return path


def _exists(path: Path) -> bool:
    """Whether a path exists. Raises FileError if the system cannot determine it."""
    try:
        return path.exists()
    except OSError as error:  # a name too long, or a folder that may not be searched
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def open_file(path: Path) -> IO[bytes]:
    """Open a file to read. Raises FileError, also for a device or pipe: its end may never come."""
    try:
        return existing_file(path).open("rb")
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error


def read_bytes(path: Path) -> bytes:
    """Read a file; an unreadable one, or one of more than `MAX_BYTES`, is a FileError."""
    try:
        with open_file(path) as file:
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    if len(content) > MAX_BYTES:
        raise FileError(f"{path}: has more than {MAX_BYTES} bytes, the limit of such a file")
    return content


def read_text(path: Path) -> str:
    """Read a UTF-8 file, without its byte-order mark; an unreadable one, or other bytes, is a FileError."""
    content = read_bytes(path)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise FileError(f"{path}: not a text file in UTF-8 but in UTF-16; save it as UTF-8")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error


def write_atomic(
    path: Path, content: bytes | str | Callable[[IO[bytes]], None], private: bool = False
) -> None:
    """Write a file whole or not at all: a temporary file beside it, synced, then renamed over it.

    ``content`` may be a function that writes into the open file. A ``private`` file is its owner's alone.
    Makes missing folders. Raises FileError when the place cannot be written.
    """
    data = content.encode() if isinstance(content, str) else content
    # Named before it is made: Ctrl-C at any moment leaves nothing behind.
    temporary = path.parent / f".{path.name}.{os.urandom(4).hex()}"
    mode = 0o600 if private else 0o666
    try:
        _make_folder(path.parent)
        try:
            with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
                if callable(data):
                    data(file)
                else:
                    file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def create(path: Path, *, overwrite: bool = False) -> IO[bytes]:
    """Open a new file to write to, in folders that are made if missing. Raises FileError.

    A file that exists is an error, also when another process makes it at this very moment. With ``overwrite``
    a new file takes its name: a process that still writes the old one does not write into the new one.
    """
    try:
        _make_folder(path.parent)
        if overwrite:
            path.unlink(missing_ok=True)
        return path.open("xb")
    except OSError as error:
        raise _not_created(path, error) from error


def require_writable(path: Path, *, overwrite: bool = False) -> None:
    """Raise FileError if no file can be written to ``path``, or if one exists, unless ``overwrite``.

    For use before work whose result goes there. Leaves nothing behind: missing folders are not made.
    """
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if _exists(path) and not overwrite:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        folder = path.parent
        while not folder.exists():
            folder = folder.parent
        with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", dir=folder):
            pass
    except OSError as error:
        raise _not_created(path, error) from error


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)) from error


def _not_created(path: Path, error: OSError) -> FileError:
    if isinstance(error, FileExistsError) and path.is_file():
        return FileError(f"{path}: exists already; choose another file, or use --overwrite")
    return FileError(f"{path}: cannot be written: {error.strerror}")


@contextlib.contextmanager
def importable_working_folder() -> Iterator[None]:
    """Let a module in the working folder be imported, but in place of no library."""
    here = str(Path.cwd())
    sys.path.append(here)
    try:
        yield
    finally:
        del sys.path[-1 - sys.path[::-1].index(here)]
