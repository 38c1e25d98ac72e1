"""Machine code of kernels on disk, in place of numba's own cache.

numba's cache does not verify its files, and checks only the source of a function, not those of the functions
that were compiled into it. Here the name of a file has a digest of everything that determines its machine
code: the sources of the kernel's module and of the modules that it imports, the free variables of a kernel
that a factory made, versions and processor. A file begins with the digest of its content.

A damaged file is made anew, and a folder that cannot be used is not used; either is one line on stderr.
"""

import ast
import contextlib
import fcntl
import functools
import hashlib
import os
import pickle
import platform
import stat
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import write_atomic

WAIT_S = 60.0
"""Longest wait for another process that compiles the same kernel."""
POLL_S = 0.02
MAX_AGE_S = 14 * 24 * 3600.0
"""A file that was not used for longer is removed."""
_VERSIONS = f"{platform.python_version()} {numba.__version__} {llvmlite.__version__} {np.__version__}"
_config: Any = numba.config
_rebuild: Any = CompileResult._rebuild
_dumps: Any = dumps
_DIGEST_BYTES = hashlib.sha256().digest_size


class MachineCode(NullCache):
    """The cache of one kernel, as numba calls it."""

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the result of an earlier compilation, or None."""
        path = self.path(sig)
        if path is None:
            return None
        target_context.refresh()
        try:
            content = path.read_bytes()
            digest, code = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
            if hashlib.sha256(code).digest() != digest:
                _report(f"{path}: is damaged; the kernel is compiled anew")
                return None
            with contextlib.suppress(OSError):
                os.utime(path)
            return _rebuild(target_context, *pickle.loads(code))
        except (FileNotFoundError, AttributeError, ImportError):  # no file, or one of a class that is gone
            return None
        except OSError as error:
            _report(f"{path}: cannot be used: {error.strerror}; the kernel is compiled anew")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the result of a compilation."""
        path = self.path(sig)
        if path is None or data.library.has_dynamic_globals:
            return
        code = _dumps(data._reduce())
        try:
            write_atomic(path, hashlib.sha256(code).digest() + code, private=True)
        except FileError as error:
            _report(f"{error}; kernels are compiled at each start")

    def locked(self, sig: Any) -> contextlib.AbstractContextManager[None]:
        """Let one process at a time look for a kernel and, if it is not there, compile it."""
        path = self.path(sig)
        return _locked(path.with_suffix(".lock")) if path else contextlib.nullcontext()

    def path(self, sig: Any) -> Path | None:
        """Return the file of the machine code for the types of arguments; None where there can be none."""
        folder = _folder()
        if folder is None:
            return None
        function = self._compiled.py_func
        processor = self._compiled.targetctx.codegen().magic_tuple()
        parts = (_VERSIONS, processor, _made_of(function), [_with_fields(kind) for kind in sig])
        digest = hashlib.sha256(repr(parts).encode()).hexdigest()[:24]
        return folder / f"{function.__module__}.{function.__qualname__}-{digest}.code"


def _with_fields(kind: Any) -> str:
    """Return the name of a type, with the fields of a named tuple, which numba's name lacks."""
    if not isinstance(kind, numba.types.BaseTuple):
        return str(kind)
    own = getattr(kind, "instance_class", tuple)
    parts: Any = kind
    return repr((own.__module__, own.__qualname__, getattr(own, "_fields", ()), [*map(_with_fields, parts)]))


def _made_of(function: Callable[..., Any]) -> str:
    """Return everything that determines a kernel's machine code, except the types of its arguments."""
    free = [_free_variable(cell.cell_contents) for cell in function.__closure__ or ()]
    place = (function.__module__, function.__qualname__, function.__code__.co_firstlineno)
    return repr((place, _sources(function.__module__), free))


def _free_variable(value: Any) -> str:
    """Return the content of a free variable. TypeError for an unknown type."""
    if hasattr(value, "py_func"):
        return _made_of(value.py_func)
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes()!r}"
    if isinstance(value, tuple):
        return repr([_free_variable(item) for item in value])
    if value is None or isinstance(value, int | float | str | np.generic):
        return repr(value)
    raise TypeError(f"a kernel has a free variable of type {type(value).__name__}")


@functools.cache
def _sources(name: str) -> str:
    """Return the digest of a module's file and of those of our packages, or its own, that it imports."""
    packages = {"rover_ncp", "deploy", "sim", name.partition(".")[0]}
    waiting, found = [name], dict[str, bytes]()
    while waiting:
        path = getattr(sys.modules.get(one := waiting.pop()), "__file__", None)
        if path and one not in found and one.partition(".")[0] in packages:
            found[one] = _source(path)
            waiting += _imported(one, found[one])
    return hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()


@functools.cache
def _imported(name: str, source: bytes) -> list[str]:
    """Return the full names of everything that a module imports while it is loaded; some are modules.

    Imports for type checkers are left out. With them the digest would depend on what a process has loaded.
    """
    try:
        waiting: list[Any] = [*ast.parse(source).body]
    except (SyntaxError, ValueError):  # an extension module, or a file that was edited after its import
        return []
    names = list[str]()
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), sys.modules[name].__package__ or "")
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            typed = isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
            for part in ("orelse",) if typed else ("body", "orelse", "handlers", "finalbody"):
                waiting += getattr(node, part, [])
    return names


@functools.cache
def _source(path: str) -> bytes:
    return Path(path).read_bytes()


@functools.cache
def _folder() -> Path | None:
    """Return the folder of this user's machine code, or None if it cannot be used."""
    try:
        root = _config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(root) / f"rover-ncp-{os.geteuid()}"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        # What is read here is run, so another user must not be able to write it.
        if status.st_uid != os.geteuid() or status.st_mode & stat.S_IWOTH:
            raise PermissionError(0, "another user can write there", str(folder))
    except (OSError, RuntimeError) as error:  # the latter: no home
        words = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
        _report(
            f"{words}: kernels are compiled at each start, unless NUMBA_CACHE_DIR names a folder for them"
        )
        return None
    oldest = time.time() - MAX_AGE_S
    with contextlib.suppress(OSError):
        for file in folder.iterdir():
            if file.stat().st_mtime < oldest:
                file.unlink()
    return folder


_reported: list[str] = []


def _report(problem: str) -> None:
    """Print a line, the first time in this process."""
    if not _reported:
        _reported.append(problem)
        print(f"rover-ncp: {problem}", file=sys.stderr, flush=True)


_held: set[Path] = set()


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that ends with its process; work without it where no lock file can be made."""
    if path in _held:
        yield
        return
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            _wait_for(stack.enter_context(path.open("ab")).fileno())
        _held.add(path)
        stack.callback(_held.discard, path)
        yield


def _wait_for(file: int) -> None:
    # A process that is stopped while it compiles must not hold up the others for good.
    deadline = time.monotonic() + WAIT_S
    while time.monotonic() < deadline:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(POLL_S)
        else:
            return
