"""The only module that touches Chipmunk below pymunk's public interface.

One pymunk rover stepped from Python costs some 6 µs a substep, nearly all of it Python; Chipmunk's own work
is 0.07 µs. So kernels compiled by numba call ``cpSpaceStep`` by its address and read and write the bodies'
fields in place. That needs two things pymunk does not promise: its cffi handle (``pymunk._chipmunk_cffi``)
and the places of a body's fields in memory. ``find_layout`` verifies both: it sets known values through
pymunk's public properties, finds them in memory, writes others there, lets Chipmunk step, and raises an error
if anything is not as expected.

The holder of an address must keep the pymunk object alive: dropping it frees the memory.
"""

import math
import struct
from functools import cache
from typing import Any, NamedTuple

import pymunk
from llvmlite import ir
from numba import types
from pymunk._chipmunk_cffi import ffi, lib

from rover_ncp.core.errors import RoverNcpError
from rover_ncp.kernels.jit import intrinsic

# Bytes of a body that are searched; the structure is longer in every Chipmunk since version 7.0.
_SEARCHED = 248


class Layout(NamedTuple):
    """Addresses of Chipmunk's functions, and offsets in bytes within a body."""

    step: int
    set_angle: int
    add_shape: int
    remove_shape: int
    position: int  # two doubles: x, y
    velocity: int  # two doubles, in the space's axes
    angle: int
    angular_velocity: int
    rotation: int  # two doubles: cosine and sine of the angle
    contacts: int  # a word that is zero while the body touches nothing


def space_address(space: pymunk.Space) -> int:
    """Return where Chipmunk keeps a space."""
    return int(ffi.cast("uintptr_t", space._space))


def body_address(body: pymunk.Body) -> int:
    """Return where Chipmunk keeps a body."""
    return int(ffi.cast("uintptr_t", body._body))


def shape_address(shape: pymunk.Shape) -> int:
    """Return where Chipmunk keeps a shape."""
    return int(ffi.cast("uintptr_t", shape._shape))


def _function_address(name: str) -> int:
    return int(ffi.cast("uintptr_t", ffi.addressof(lib, name)))


@cache
def find_layout() -> Layout:
    """Find the fields of a body; raises RoverNcpError when this pymunk hides them."""
    space = pymunk.Space()
    body = pymunk.Body(3.25, 7.75)
    shape = pymunk.Circle(body, 1.0)
    space.add(body, shape)
    body.position, body.velocity = (101.5, 102.5), (103.5, 104.5)
    body.angle, body.angular_velocity = 0.625, 105.5
    image = bytes(_memory(body))
    fields = {
        # The position stands a second time in the body's transform, which each step computes from the first.
        "position": _offset(image, "position", 2, 101.5, 102.5),
        "velocity": _offset(image, "velocity", 1, 103.5, 104.5),
        "angle": _offset(image, "angle", 1, 0.625),
        "angular_velocity": _offset(image, "angular velocity", 1, 105.5),
        "rotation": _offset(image, "rotation", 1, math.cos(0.625), math.sin(0.625)),
    }
    _check_writing(space, body, fields)
    return Layout(
        step=_function_address("cpSpaceStep"),
        set_angle=_function_address("cpBodySetAngle"),
        add_shape=_function_address("cpSpaceAddShape"),
        remove_shape=_function_address("cpSpaceRemoveShape"),
        contacts=_contacts_offset(space, body),
        **fields,
    )


def _memory(body: pymunk.Body) -> ffi.buffer:
    return ffi.buffer(ffi.cast("char *", body._body), _SEARCHED)


def _unexpected(what: str) -> RoverNcpError:
    return RoverNcpError(
        f"pymunk {pymunk.version} keeps {what} elsewhere than expected: install that of constraints.txt"
    )


def _offset(image: bytes, name: str, times: int, *values: float) -> int:
    """Return where the values stand first, provided that they stand so many times."""
    wanted = struct.pack(f"{len(values)}d", *values)
    found = [at for at in range(0, len(image), 8) if image[at : at + len(wanted)] == wanted]
    if len(found) != times:
        raise _unexpected(f"a body's {name}")
    return found[0]


def _check_writing(space: pymunk.Space, body: pymunk.Body, fields: dict[str, int]) -> None:
    """Move a body as a kernel does, and check that Chipmunk continues from there."""
    memory = _memory(body)
    for name, values in (("position", (7.0, 8.0)), ("velocity", (1.0, 2.0)), ("angular_velocity", (4.0,))):
        content = struct.pack(f"{len(values)}d", *values)
        memory[fields[name] : fields[name] + len(content)] = content
    body.angle = 0.5
    placed = (*body.position, body.angle)
    space.step(0.25)
    moved = (*body.position, *body.velocity, body.angle, body.angular_velocity)
    if placed != (7.0, 8.0, 0.5) or moved != (7.25, 8.5, 1.0, 2.0, 1.5, 4.0):
        raise _unexpected("a body's state")


def _contacts_offset(space: pymunk.Space, body: pymunk.Body) -> int:
    """Find the word that is set when, and only when, the body touches something."""

    def words() -> tuple[int, ...]:
        body.velocity, body.angular_velocity, body.angle = (0.0, 0.0), 0.0, 0.0
        space.step(0.01)
        return struct.unpack(f"{_SEARCHED // 8}Q", _memory(body))

    alone = words()
    wall = pymunk.Circle(space.static_body, 1.0, offset=(body.position.x + 1.9, body.position.y))
    space.add(wall)
    touching = words()
    space.remove(wall)
    again = words()
    # Velocities are set by a contact, too; a double does not begin like an address of the same heap.
    heap = body_address(body) >> 48
    found = [
        8 * i
        for i, word in enumerate(touching)
        if word and word >> 48 == heap and not alone[i] and not again[i]
    ]
    if len(found) != 1:
        raise _unexpected("a body's contacts")
    return found[0]


_POINTER, _DOUBLE, _WORD = ir.IntType(8).as_pointer(), ir.DoubleType(), ir.IntType(64)


def _call_with(last: ir.Type, result: ir.Type) -> Any:
    """Return a function for kernels that calls a C function of a pointer and ``last``, a pointer or a double.

    Its result is not wanted.
    """

    @intrinsic
    def call(_context: Any, function: Any, thing: Any, other: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            callee = builder.inttoptr(arguments[0], ir.FunctionType(result, [_POINTER, last]).as_pointer())
            second = arguments[2] if last is _DOUBLE else builder.inttoptr(arguments[2], last)
            builder.call(callee, [builder.inttoptr(arguments[1], _POINTER), second])
            return context.get_dummy_value()

        given = types.float64 if last is _DOUBLE else types.int64
        return types.void(types.int64, types.int64, given), generate

    return call


call_with_number = _call_with(_DOUBLE, ir.VoidType())
call_with_thing = _call_with(_POINTER, ir.VoidType())
add_thing = _call_with(_POINTER, _POINTER)
"""As ``call_with_thing``, for a C function that returns what was added."""


def _load(kind: ir.Type, number: Any) -> Any:
    """Return a function for kernels that reads the number at an address."""

    @intrinsic
    def load_at(_context: Any, address: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.load(builder.inttoptr(arguments[0], kind.as_pointer()))

        return number(types.int64), generate

    return load_at


load = _load(_DOUBLE, types.float64)
load_word = _load(_WORD, types.int64)


@intrinsic
def store(_context: Any, address: Any, value: Any) -> Any:
    """Within a kernel: write a double to an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        builder.store(arguments[1], builder.inttoptr(arguments[0], _DOUBLE.as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.float64), generate
