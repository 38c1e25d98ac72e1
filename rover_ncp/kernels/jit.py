"""The compiler of the numerical kernels: numba, strict IEEE arithmetic, machine code kept on disk.

numba's own cache checks only the file of a function, not those of the functions that were compiled into it.
After an update of one of them it would silently run the old code. Here every kernel has a stamp of all that
it is made of: its file, the kernels it calls, its constants and, if a factory made it, its free variables.
Processes that start together compile each kernel once: the first locks it, the others wait and load it.

Arithmetic: no fastmath, so LLVM neither reorders nor fuses operations and a kernel gives the same bits on
every machine, whatever its vector width. Division by zero gives infinities as in numpy; the test that numba
would make by default keeps loops from being vectorised.
"""

import contextlib
import fcntl
import functools
import hashlib
import inspect
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, typeof
from numba.core import cgutils, types
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
    can take longer than the work. Assign number by number there: ``x[:, lane] = y`` costs 40 to 500 kB of
    machine code at each place, as numba prepares for all shapes.
    """
    return _compiled(function, {"error_model": "numpy", "forceinline": True})


def bound(kernel: Any, *arguments: Any) -> Callable[[], Any]:
    """Return a call of a kernel with these arguments.

    At every other call numba looks up the types of all arguments, which for large tuples of arrays takes
    longer than to hand them over.
    """
    return functools.partial(kernel.compile(tuple(map(typeof, arguments))), *arguments)


@in_kernels
def borrowed(_context: Any, value: Any) -> Any:
    """Within a kernel: return an array, or a tuple with the arrays in it, that count no references.

    numba counts up and down, by slow atomic operations, whenever an array is taken out of a tuple; in a
    loop over ticks that takes longer than much of the work. The array must outlive this use, as arguments
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


@in_kernels
def call_fortran(_context: Any, routine: Any, arguments: Any) -> Any:
    """Within a kernel: call a Fortran subroutine, given its address and a tuple of arguments.

    These are integers, which also stand for characters, doubles and arrays. Fortran takes a matrix for its
    transpose. Only arrays can be written to.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        addresses = []
        for i, kind in enumerate(signature.args[1]):
            value = builder.extract_value(values[1], i)
            if isinstance(kind, types.Array):
                address = context.make_array(kind)(context, builder, value).data
            else:
                number = builder.trunc(value, ir.IntType(32)) if isinstance(kind, types.Integer) else value
                address = cgutils.alloca_once_value(builder, number)  # type: ignore[no-untyped-call]
            addresses.append(builder.bitcast(address, pointer))
        called = ir.FunctionType(ir.VoidType(), [pointer] * len(addresses)).as_pointer()
        builder.call(builder.inttoptr(values[0], called), addresses)
        return context.get_dummy_value()

    return types.void(types.int64, arguments), generate


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    try:
        compiled: Any = njit(cache=True, **options)(function)
        _stamp_the_key(compiled._cache, function)
        _compile_once(compiled)
    except (RuntimeError, AttributeError):
        # No writable folder for the cache, or a numba whose cache works in another way: compile each time.
        compiled = njit(**options)(function)
    return compiled


def _stamp_the_key(cache: Any, function: Callable[..., Any]) -> None:
    """Look for machine code by the stamp of its kernel.

    The stamp is taken at the first look: what the kernel calls may be further down in its file. numba's own
    key has the free variables of a function, too, but a compiled one among them differs in each process.
    """
    if not hasattr(cache, "_index_key"):
        raise AttributeError("numba's cache has no _index_key")
    cached_stamp = functools.cache(stamp)
    cache._index_key = lambda signature, codegen: (signature, codegen.magic_tuple(), cached_stamp(function))
    load_index = cache._cache_file._load_index

    def load_readable_index() -> Any:
        # An index names the classes of tuples that a kernel takes; one of them may have been renamed since.
        try:
            return load_index()
        except (AttributeError, ImportError):
            return {}

    cache._cache_file._load_index = load_readable_index


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
    """Return a digest of the sources and constants that are compiled into a kernel.

    Covers the kernels that it calls, and the free variables of a kernel that was made by a factory.
    TypeError for a free variable of another type than function, class, number, text, tuple or array.
    """
    digest = hashlib.sha256()
    _add_function(function, digest, set())
    return digest.hexdigest()


def _add_function(function: Callable[..., Any], digest: Any, seen: set[Callable[..., Any]]) -> None:
    if function in seen:
        return
    seen.add(function)
    # Not the path: the same source elsewhere, or by another link, is the same machine code.
    digest.update(f"{function.__module__}:{function.__qualname__}".encode())
    with open(inspect.getfile(function), "rb") as file:  # noqa: PTH123  # a Path costs more than the read
        digest.update(file.read())
    code, used = function.__code__, function.__globals__
    names = _names(code)
    found = [used[key] for key in names if key in used]
    modules = [item for item in found if isinstance(item, ModuleType)]
    for item in (
        *found,
        *(getattr(module, key) for module in modules for key in names if hasattr(module, key)),
    ):
        _add_value(item, digest, seen)
    for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
        if not _add_value(cell.cell_contents, digest, seen):
            kind = type(cell.cell_contents).__name__
            raise TypeError(f"kernel {function.__qualname__}: the stamp does not cover {name}, a {kind}")


def _add_value(value: Any, digest: Any, seen: set[Callable[..., Any]]) -> bool:
    """Add a value that a kernel uses; return whether it could be added."""
    called = getattr(value, "py_func", None) or getattr(value, "_defn", None)
    if called is not None:
        _add_function(called, digest, seen)
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, tuple):
        added = [_add_value(item, digest, seen) for item in value]
        return all(added)
    elif isinstance(value, type):
        digest.update(value.__qualname__.encode())
    elif value is None or isinstance(value, int | float | str | np.generic):
        digest.update(repr(value).encode())
    else:
        return False
    return True


def _names(code: CodeType) -> list[str]:
    names = list(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names += _names(constant)
    return names
