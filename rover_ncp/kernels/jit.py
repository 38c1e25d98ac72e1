"""The compiler of the numerical kernels: numba, strict IEEE arithmetic, machine code kept on disk.

numba's own cache asks only whether the file of a function has changed, not the files of the functions that
were compiled into it. After an update of one of them it would go on running the old code, silently. Here
every kernel carries a stamp of all it is made of: its file, the kernels it calls, the constants it reads.
Processes that start together compile each kernel once: the first locks it, the others wait and load it.

Arithmetic: no fastmath, so LLVM neither reorders nor fuses operations and a kernel gives the same bits on
every machine, whatever its vector width. Division by zero gives infinities as in numpy; the test that numba
would make by default keeps loops from being vectorised.
"""

import contextlib
import fcntl
import hashlib
import inspect
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from numba import njit
from numba.core import types
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import intrinsic

WAIT_S = 60.0
"""How long a process waits for another that compiles the same kernel, before it compiles that one itself."""
POLL_S = 0.02


def in_kernels(generator: Callable[..., Any]) -> Any:
    """Make a code generator into a function for kernels, which do not pass its first argument."""
    return intrinsic(generator)


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function with numba on its first call, or load what an earlier process compiled."""
    return _compiled(function, {"error_model": "numpy"})


def inlined_kernel(function: Callable[..., Any]) -> Any:
    """Compile a part of other kernels into each place where it is called.

    For what takes large tuples, and is called often: a call hands over every array of them by value, which
    can take longer than the work.
    """
    return _compiled(function, {"error_model": "numpy", "forceinline": True})


@in_kernels
def borrowed(_context: Any, value: Any) -> Any:
    """Within a kernel: return an array, or a tuple with the arrays in it, that count no references.

    numba counts up and down, by slow atomic operations, whenever an array is taken out of a tuple; in a
    loop over ticks that takes longer than much of the work. What is lent must outlive its use, as arguments
    from Python do.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _without_owner(context, builder, signature.args[0], arguments[0])

    return value(value), generate


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = context.get_constant_null(types.voidptr)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        for i, part in enumerate(parts):
            lent = _without_owner(context, builder, part, builder.extract_value(value, i))
            value = builder.insert_value(value, lent, i)
    return value


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    try:
        compiled: Any = njit(cache=True, **options)(function)
        _stamp_when_used(compiled._cache, function)
        _compile_once(compiled)
    except (RuntimeError, AttributeError):
        # No writable folder for the cache, or a numba that keeps its stamp elsewhere: compile each time.
        compiled = njit(**options)(function)
    return compiled


def _stamp_when_used(cache: Any, function: Callable[..., Any]) -> None:
    """Add the stamp when the kernel is first looked for: what it calls may stand further down in its file."""
    cache_file, load = cache._cache_file, cache.load_overload
    of_the_file = cache_file._source_stamp

    def load_overload(*arguments: Any) -> Any:
        if cache_file._source_stamp is of_the_file:
            cache_file._source_stamp = (of_the_file, stamp(function))
        return load(*arguments)

    cache.load_overload = load_overload


def _compile_once(compiled: Any) -> None:
    """Let one process at a time look for a kernel on the disk and, if it is not there, compile it."""
    compile_here, lock = compiled.compile, Path(f"{compiled._cache._cache_file._index_path}.lock")

    def compile_locked(signature: Any) -> Any:
        # numba's own lock first, for all threads in the same order. A kernel is locked before those it calls.
        with global_compiler_lock, _locked(lock):
            return compile_here(signature)

    compiled.compile = compile_locked


_held: set[Path] = set()


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that ends with its process; work without it where no lock file can be made."""
    if path in _held:
        yield
        return
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
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


def stamp(function: Callable[..., Any]) -> str:
    """Return a digest of the sources and constants that are compiled into a kernel."""
    digest = hashlib.sha256()
    _collect(function, digest, set())
    return digest.hexdigest()


def _collect(function: Callable[..., Any], digest: Any, seen: set[str]) -> None:
    source = inspect.getfile(function)
    # Not the path: the same source elsewhere, or by another link, is the same machine code.
    name = f"{function.__module__}:{function.__qualname__}"
    if name in seen:
        return
    seen.add(name)
    digest.update(name.encode())
    with open(source, "rb") as file:  # noqa: PTH123  # a Path costs more than the read
        digest.update(file.read())
    names = _names(function.__code__)
    found = [function.__globals__[key] for key in names if key in function.__globals__]
    modules = [item for item in found if isinstance(item, ModuleType)]
    found += [getattr(module, key) for module in modules for key in names if hasattr(module, key)]
    for item in found:
        called = getattr(item, "py_func", None) or getattr(item, "_defn", None)
        if called is not None:
            _collect(called, digest, seen)
        elif isinstance(item, int | float | str | tuple):
            digest.update(repr(item).encode())


def _names(code: CodeType) -> list[str]:
    names = list(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names += _names(constant)
    return names
