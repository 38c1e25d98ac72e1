"""Eight lanes as one value inside a numba kernel.

LLVM's loop vectoriser spends more time on our short loops, on checks that arrays do not overlap, than the
arithmetic takes. A ``Vector`` has ``+``, ``-``, ``*`` and ``/`` on eight float64 at once, mixed with plain
numbers as in numpy. LLVM compiles it for one AVX-512 register, two of AVX2, four of SSE2 or NEON, with the
same bits.

Only kernels can use these functions; called from Python they raise NotImplementedError.
"""

import functools
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import models, overload, register_model
from numpy.typing import NDArray

from rover_ncp.kernels.jit import intrinsic

WIDTH = 8
"""Lanes in a vector."""


RowArray = NDArray[np.uint64]
"""Indices that are never negative: numba checks every signed index for counting from the end."""


def aligned_zeros(*shape: int) -> NDArray[np.float64]:
    """Return zeros that begin where a cache line may: vectors across two of them take longer to load."""
    size = math.prod(shape)
    room = np.zeros(size + WIDTH)
    first = -(room.ctypes.data // room.itemsize) % WIDTH
    return room[first : first + size].reshape(shape)


_DOUBLES = ir.VectorType(ir.DoubleType(), WIDTH)
_EXPONENT_SHIFT = 52  # where the exponent stands in a float64


class VectorType(types.Type):
    """The type of eight float64 in a register."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{WIDTH}")


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: VectorType) -> None:
        super().__init__(manager, vector, _DOUBLES)  # type: ignore[no-untyped-call]


_vector = VectorType()


def _broadcast(context: Any, builder: Any, value: Any, kind: Any) -> Any:
    """Return a vector as it is, and a number in all eight places."""
    if isinstance(kind, VectorType):
        return value
    number = context.cast(builder, value, kind, types.float64)
    first = builder.insert_element(ir.Constant(_DOUBLES, ir.Undefined), number, _integer(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, first, zeros)


def _broadcast_all(context: Any, builder: Any, signature: Any, arguments: Any) -> list[Any]:
    return [_broadcast(context, builder, *pair) for pair in zip(arguments, signature.args, strict=True)]


def _define(python_operator: Callable[[Any, Any], Any], instruction: str) -> None:
    @intrinsic
    def apply(typing_context: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*_broadcast_all(context, builder, signature, arguments))

        return _vector(a, b), generate

    @overload(python_operator)
    def on_vectors(a, b):  # type: ignore[no-untyped-def]  # numba compares with the lambda's signature
        if isinstance(a, VectorType) or isinstance(b, VectorType):
            return lambda a, b: apply(a, b)  # noqa: PLW0108  # numba wants a function to compile
        return None


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_operator, _instruction)


def _pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return where row ``arguments[2]`` of block ``arguments[1]`` of a (blocks, rows, WIDTH) array starts."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    rows = builder.extract_value(array.shape, 1)
    row = builder.add(builder.mul(arguments[1], rows), arguments[2])
    first = builder.gep(array.data, [builder.mul(row, ir.Constant(row.type, WIDTH))])
    return builder.bitcast(first, _DOUBLES.as_pointer())


@intrinsic
def load(typing_context: Any, array: Any, block: Any, row: Any) -> Any:
    """Return a row of a C-contiguous (blocks, rows, WIDTH) array as a vector; nothing checks the indices."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = builder.load(_pointer(context, builder, signature, arguments))
        value.align = 8  # numpy promises no more
        return value

    return _vector(array, types.intp, types.intp), generate


@intrinsic
def store(typing_context: Any, array: Any, block: Any, row: Any, value: Any) -> Any:
    """Write a vector to a row of a C-contiguous (blocks, rows, WIDTH) array; nothing checks the indices."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        written = builder.store(arguments[3], _pointer(context, builder, signature, arguments))
        written.align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, value), generate


def _row_of_lanes(context: Any, builder: Any, signature: Any, arguments: Any) -> tuple[Any, Any, Any]:
    """Return where row ``arguments[1]`` of a (rows, L) array has lane ``arguments[2]``; L; whether eight
    lanes are left from there on."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    lanes, start = builder.extract_value(array.shape, 1), arguments[2]
    first = builder.gep(array.data, [builder.add(builder.mul(arguments[1], lanes), start)])
    return first, lanes, builder.icmp_signed("<=", builder.add(start, _integer(WIDTH)), lanes)


def _integer(value: int) -> Any:
    return ir.Constant(ir.IntType(64), value)


@intrinsic
def load_lanes(typing_context: Any, array: Any, row: Any, start: Any) -> Any:
    """Return eight lanes of a row of a C-contiguous (rows, L) array as a vector; beyond the last lane, that
    one again. Nothing checks the indices."""
    if array.layout != "C":
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, lanes, are_whole = _row_of_lanes(context, builder, signature, arguments)
        with builder.if_else(are_whole, likely=True) as (whole, part):
            with whole:
                together = builder.load(builder.bitcast(first, _DOUBLES.as_pointer()))
                together.align = 8
                whole_block = builder.block
            with part:
                gathered = ir.Constant(_DOUBLES, ir.Undefined)
                last = builder.sub(builder.sub(lanes, arguments[2]), _integer(1))
                for i in range(WIDTH):
                    is_there = builder.icmp_signed("<", _integer(i), last)
                    place = builder.select(is_there, _integer(i), last)
                    number = builder.load(builder.gep(first, [place]))
                    gathered = builder.insert_element(gathered, number, _integer(i))
                part_block = builder.block
        value = builder.phi(_DOUBLES)
        value.add_incoming(together, whole_block)
        value.add_incoming(gathered, part_block)
        return value

    return _vector(array, types.intp, types.intp), generate


@intrinsic
def store_lanes(typing_context: Any, array: Any, row: Any, start: Any, value: Any) -> Any:
    """Write a vector to eight lanes of a row of a C-contiguous (rows, L) array, as far as there are so many.
    Nothing checks the indices."""
    if array.layout != "C":
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, lanes, are_whole = _row_of_lanes(context, builder, signature, arguments)
        with builder.if_else(are_whole, likely=True) as (whole, part):
            with whole:
                together = builder.store(arguments[3], builder.bitcast(first, _DOUBLES.as_pointer()))
                together.align = 8
            with part:
                for i in range(WIDTH):
                    place = builder.add(arguments[2], _integer(i))
                    with builder.if_then(builder.icmp_signed("<", place, lanes)):
                        number = builder.extract_element(arguments[3], _integer(i))
                        builder.store(number, builder.gep(first, [_integer(i)]))
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, value), generate


@intrinsic
def everywhere(typing_context: Any, number: Any) -> Any:
    """Return a vector of one number in all eight places."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _broadcast(context, builder, arguments[0], signature.args[0])

    return _vector(number), generate


def _chosen(a: Any, b: Any, comparison: str) -> Any:
    """Return ``b`` where it compares so with ``a``, else ``a``; each a vector or a number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second = _broadcast_all(context, builder, signature, arguments)
        return builder.select(builder.fcmp_ordered(comparison, second, first), second, first)

    return _vector(a, b), generate


@intrinsic
def larger(typing_context: Any, a: Any, b: Any) -> Any:
    """Return max(a, b), place by place, as Python has it: ``a`` unless ``b`` is greater."""
    return _chosen(a, b, ">")


@intrinsic
def smaller(typing_context: Any, a: Any, b: Any) -> Any:
    """Return min(a, b), place by place, as Python has it: ``a`` unless ``b`` is less."""
    return _chosen(a, b, "<")


@intrinsic
def where_less(typing_context: Any, a: Any, b: Any, then: Any, otherwise: Any) -> Any:
    """Return ``then`` where ``a`` is less than ``b``, ``otherwise`` elsewhere, place by place."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, yes, no = _broadcast_all(context, builder, signature, arguments)
        return builder.select(builder.fcmp_ordered("<", first, second), yes, no)

    return _vector(a, b, then, otherwise), generate


def _places(context: Any, builder: Any, signature: Any, arguments: Any) -> list[Any]:
    """Return pointers to the doubles ``arguments[2]`` bytes behind eight addresses, those of an int64 array
    from ``arguments[1]`` on."""
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    first = builder.gep(array.data, [arguments[1]])
    addresses = [builder.load(builder.gep(first, [_integer(i)])) for i in range(WIDTH)]
    pointer = ir.DoubleType().as_pointer()
    return [builder.inttoptr(builder.add(address, arguments[2]), pointer) for address in addresses]


@intrinsic
def gather(typing_context: Any, addresses: Any, start: Any, offset: Any) -> Any:
    """Return the doubles ``offset`` bytes behind eight addresses, those of a contiguous array from ``start``
    on, as a vector; nothing checks any of it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        gathered = ir.Constant(_DOUBLES, ir.Undefined)
        for i, place in enumerate(_places(context, builder, signature, arguments)):
            gathered = builder.insert_element(gathered, builder.load(place), _integer(i))
        return gathered

    return _vector(addresses, types.intp, types.intp), generate


@intrinsic
def scatter(typing_context: Any, addresses: Any, start: Any, offset: Any, value: Any) -> Any:
    """Write a vector to the doubles ``offset`` bytes behind eight addresses, those of a contiguous array from
    ``start`` on, the first one first; nothing checks any of it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for i, place in enumerate(_places(context, builder, signature, arguments)):
            builder.store(builder.extract_element(arguments[3], _integer(i)), place)
        return context.get_dummy_value()

    return types.void(addresses, types.intp, types.intp, value), generate


@intrinsic
def total(typing_context: Any, vector: Any) -> Any:
    """Return the sum of a vector's eight numbers, added from the first to the last."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers = [builder.extract_element(arguments[0], _integer(i)) for i in range(WIDTH)]
        return functools.reduce(builder.fadd, numbers)

    return types.float64(_vector), generate


@intrinsic
def scale_by_power_of_two(typing_context: Any, value: Any, shifted: Any) -> Any:
    """Return value * 2**n, where n is the integer in the lowest bits of ``shifted`` (see ``solver.exp2``).

    For a number or a vector; the result must be a normal number.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        is_vector = isinstance(value, VectorType)
        integers = ir.VectorType(ir.IntType(64), WIDTH) if is_vector else ir.IntType(64)
        shift = [_EXPONENT_SHIFT] * WIDTH if is_vector else _EXPONENT_SHIFT
        mantissa, integer = (builder.bitcast(argument, integers) for argument in arguments)
        scaled = builder.add(mantissa, builder.shl(integer, ir.Constant(integers, shift)))
        return builder.bitcast(scaled, _DOUBLES if is_vector else ir.DoubleType())

    return value(value, value), generate
