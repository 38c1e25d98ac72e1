"""The only module that reaches Chipmunk below pymunk's public interface: addresses for the native library.

One pymunk rover stepped from Python costs some 6 µs a substep, nearly all of it Python; Chipmunk's own work
is 0.07 µs. So the library calls Chipmunk's public functions by their addresses in pymunk's cffi module.

The holder of an address must keep the pymunk object alive: dropping it frees the memory.
"""

import ctypes
from typing import NamedTuple

import pymunk
from pymunk import _chipmunk
from pymunk._chipmunk_cffi import ffi

from rover_ncp.core.errors import RoverNcpError


class Functions(NamedTuple):
    """Addresses of Chipmunk's functions, in the order of ``Chipmunk`` in fleet.h."""

    space_step: int
    space_add_shape: int
    space_remove_shape: int
    body_get_position: int
    body_set_position: int
    body_get_angle: int
    body_set_angle: int
    body_get_rotation: int
    body_get_velocity: int
    body_set_velocity: int
    body_get_angular_velocity: int
    body_set_angular_velocity: int
    body_each_arbiter: int
    body_set_velocity_update_func: int
    body_update_position: int


def find_functions() -> Functions:
    """Return the addresses. Raises RoverNcpError when this pymunk lacks a function."""
    names = ("cp" + "".join(word.title() for word in field.split("_")) for field in Functions._fields)
    library = ctypes.CDLL(_chipmunk.__file__)
    try:
        return Functions(*(ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names))
    except AttributeError as error:
        raise RoverNcpError(
            f"pymunk {pymunk.version} lacks a function ({error}): install that of constraints.txt"
        ) from error


def space_address(space: pymunk.Space) -> int:
    """Return where Chipmunk keeps a space."""
    return int(ffi.cast("uintptr_t", space._space))


def body_address(body: pymunk.Body) -> int:
    """Return where Chipmunk keeps a body."""
    return int(ffi.cast("uintptr_t", body._body))


def shape_address(shape: pymunk.Shape) -> int:
    """Return where Chipmunk keeps a shape."""
    return int(ffi.cast("uintptr_t", shape._shape))
