"""Arrays in a stored run: a shape and hexadecimal bytes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.learn.search.base import Vector

_LITTLE_ENDIAN = np.dtype("<f8")


def pack(array: Vector) -> dict[str, Any]:
    """Return an array of float64 as plain values."""
    return {"shape": list(array.shape), "float64": array.astype(_LITTLE_ENDIAN).tobytes().hex()}


def unpack(packed: Mapping[str, Any], shape: tuple[int | None, ...]) -> Vector:
    """Return the array, which must have this shape, where None stands for any length. Raises ValueError."""
    found = tuple(packed["shape"])
    if len(found) != len(shape) or any(b not in (None, a) for a, b in zip(found, shape, strict=True)):
        raise ValueError(f"expected an array of shape {shape}, got {found}")
    flat = np.frombuffer(bytes.fromhex(packed["float64"]), _LITTLE_ENDIAN)
    return flat.astype(np.float64).reshape(found)
