"""The compiler of the numerical kernels: numba, strict IEEE arithmetic, machine code kept on disk.

Processes that start together compile each kernel once: the first locks it, the others wait and load it.

Arithmetic: no fastmath, so LLVM neither reorders nor fuses operations and a kernel gives the same bits on
every machine, whatever its vector width. Division by zero gives infinities as in numpy; the test that numba
would make by default keeps loops from being vectorised.
"""

import functools
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import njit, typeof
from numba.core import cgutils, types
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import intrinsic as numba_intrinsic

from rover_ncp.core.errors import UsageError
from rover_ncp.kernels.machine_code import MachineCode

if getattr(numba.config, "DISABLE_JIT", False):
    raise UsageError("NUMBA_DISABLE_JIT is set, but kernels run only when they are compiled: unset it")


def intrinsic(generator: Callable[..., Any]) -> Any:
    """Make a code generator into a function for kernels, which do not pass its first argument."""
    return numba_intrinsic(generator)


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


@intrinsic
def without_refcounts(_context: Any, value: Any) -> Any:
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


@intrinsic
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
    compiled: Any = njit(**options)(function)
    compile_here, compiled._cache = compiled.compile, MachineCode(compiled)

    def compile_locked(signature: Any) -> Any:
        # numba's own lock first, for all threads in the same order. A kernel is locked before those it calls.
        with global_compiler_lock, compiled._cache.locked(signature):
            return compile_here(signature)

    compiled.compile = compile_locked
    return compiled
