"""The native library: loads it, checks what it is given, and alone calls it.

A C++ structure has the fields of a named tuple in the same order: an array as its address and shape, a number
as 8 bytes, a named tuple as its own fields. `structures` writes them so. It refuses arrays of another type,
order or shape than their `Axes` say, and indices that point nowhere: the library checks nothing.
"""

import ctypes
import hashlib
import math
from collections.abc import Callable
from functools import cache, partial
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from rover_ncp.core.errors import UsageError

FloatArray = NDArray[np.float64]

_FLOAT64 = np.dtype(np.float64)
WIDTH = 8
"""Lanes that are stored side by side, as in arrays.h."""
_SOURCES = _FOLDER = Path(__file__).parent
_LONG, _DOUBLE, _POINTER = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
_FUNCTIONS: dict[str, list[Any]] = {
    "rover_ncp_sources": [ctypes.c_char_p],
    "rover_ncp_has_avx2": [_LONG],
    "rover_ncp_signals": [_LONG],
    "rover_ncp_sizes": [None, _POINTER],
    "rover_ncp_fill_lanes": [None, _POINTER, _POINTER, _LONG],
    "rover_ncp_tick_lanes": [None, *[_POINTER] * 3],
    "rover_ncp_run_episodes": [_LONG, *[_POINTER] * 7, _LONG],
    "rover_ncp_size_of_least_squares": [_LONG],
    "rover_ncp_submit": [_LONG, _POINTER, _LONG, _LONG, _POINTER, _POINTER],
    "rover_ncp_damped_steps": [_LONG, _POINTER, _LONG, _DOUBLE, _DOUBLE, _POINTER, _POINTER],
    "rover_ncp_measure_slopes": [None, *[_POINTER] * 5],
    "rover_ncp_correct_slopes": [None, _POINTER, _DOUBLE, *[_POINTER] * 4],
    "rover_ncp_survival": [_DOUBLE, _POINTER, _DOUBLE, _POINTER],
}
"""The result and the arguments of each function."""
_TICKS_OF_A_CALL = 1000
"""Control ticks of all lanes, at most 0.1 s: Ctrl-C is noticed between two calls."""


def load(suffix: str = "") -> ctypes.CDLL:
    """Load a build: that for all processors, or ``-avx2``.

    Raises OSError without it, UsageError for one of other sources than those beside it.
    """
    loaded = ctypes.CDLL(str(_FOLDER / f"librover_ncp{suffix}.so"))
    loaded.rover_ncp_sources.restype = ctypes.c_char_p
    if loaded.rover_ncp_sources().decode() != _digest(_SOURCES):
        raise UsageError(f"the native library is not that of its sources in {_SOURCES}: {_how_to_build()}")
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


@cache
def _digest(folder: Path) -> str:
    """Return the digest of the sources in a folder, as ``hatch_build.py`` makes it."""
    sources = sorted([*folder.glob("*.cpp"), *folder.glob("*.h")])
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]


@cache
def library() -> ctypes.CDLL | None:
    """Return the library, that for AVX2 if it can; None where it was not built.

    Raises UsageError for one of other sources.
    """
    try:
        loaded = load()
    except OSError:
        return None
    if loaded.rover_ncp_has_avx2() and (_FOLDER / "librover_ncp-avx2.so").exists():
        loaded = load("-avx2")
    return loaded


def required() -> ctypes.CDLL:
    """Return the library. Raises UsageError where it was not built."""
    if (loaded := library()) is None:
        raise UsageError(
            "this needs the native library, which was not built: install a C++ compiler (g++ or clang) or "
            f"the Python package ziglang, then {_how_to_build()}"
        )
    return loaded


def _how_to_build() -> str:
    """Return what to do in a checkout, or in an installation, whose wheel pip may have in its cache."""
    if (checkout := _SOURCES.parents[1]).joinpath("hatch_build.py").exists():
        return f"run python {checkout / 'hatch_build.py'}"
    return "install rover-ncp again with pip's options --force-reinstall --no-cache-dir"


class Axes:
    """The axes of an array: those of one name have one length in all arguments of a call.

    A number is the length itself; ``name+1`` is one more than another axis, ``a*b`` the product of two, 0
    where no argument has them; ``a|b`` is ``b`` where none has ``a``; ``.name`` is of the array's tuple.
    An empty array fits where all names end in ``?``. The numbers are indices if ``below`` names the axis that
    they point into: from ``lowest`` on.
    """

    def __init__(self, *names: str | int, below: str | None = None, lowest: int = 0) -> None:
        self.names, self.below, self.lowest = [str(name) for name in names], below, lowest


class Structure(ctypes.c_void_p):
    """A named tuple or an array as the library reads it. It keeps the arrays whose addresses it has."""

    def __init__(self, value: Any, words: list[int]) -> None:
        self._value, self._words = value, np.array(words, np.uint64)
        super().__init__(self._words.ctypes.data)

    @property
    def size(self) -> int:
        """Its bytes."""
        return self._words.nbytes


def structures(**arguments: Any) -> list[Structure]:
    """Return the structures of named tuples, and of arrays, each given as (array, type, axes).

    Raises TypeError for an array of another type or order, ValueError for another shape or an index that is
    out of range.
    """
    lengths = _Lengths()
    found = []
    for name, value in arguments.items():
        is_array = not hasattr(value, "_fields")
        words = _array(lengths, name, *value) if is_array else _pack(lengths, name, value)
        found.append(Structure(value[0] if is_array else value, words))
    lengths.check_indices()
    return found


def _pack(lengths: "_Lengths", path: str, value: Any) -> list[int]:
    """Return the words of a named tuple."""
    words: list[int] = []
    kind_of_tuple: Any = type(value)
    for (kind, axes), name, part in zip(_fields(kind_of_tuple), value._fields, value, strict=True):
        where = f"{path}.{name}"
        if axes is not None:
            words += _array(lengths, where, part, kind, axes)
        elif hasattr(part, "_fields"):
            words += _pack(lengths, where, part)
        elif isinstance(part, tuple):
            words += [int(number) for number in part]
        elif isinstance(part, float):
            words.append(int(np.float64(part).view(np.uint64)))
        else:
            words.append(int(part))
    return words


def _array(lengths: "_Lengths", path: str, array: Any, kind: Any, axes: Axes) -> list[int]:
    """Return the words of an array."""
    if not isinstance(array, np.ndarray) or array.dtype != kind or not array.flags.c_contiguous:
        found = (
            f"{array.dtype} with strides {array.strides}" if isinstance(array, np.ndarray) else repr(array)
        )
        raise TypeError(f"{path} is {found}, expected a C-contiguous array of {np.dtype(kind)}")
    if array.ndim != len(axes.names):
        raise ValueError(f"{path} has the shape {array.shape}, expected the axes {', '.join(axes.names)}")
    if any(array.shape) or not all(name.endswith("?") for name in axes.names):
        for name, length in zip(axes.names, array.shape, strict=True):
            lengths.compare(path, name.rstrip("?"), length)
    if axes.below is not None:
        lengths.indices.append((path, array, axes))
    return [array.ctypes.data, *array.shape]


class _Lengths:
    """The lengths of axes by name, and the indices that point into them."""

    def __init__(self) -> None:
        self.indices: list[tuple[str, NDArray[Any], Axes]] = []
        self._known: dict[str, int] = {}

    def find(self, path: str, name: str) -> int | None:
        """Return the length of an axis named by the array at ``path``, None if no array has it."""
        if "*" in name:
            return math.prod(self.find(path, factor) or 0 for factor in name.split("*"))
        for choice in name.split("|"):
            base, _, more = choice.partition("+")
            if base.isdecimal():
                return int(base)
            if (length := self._known.get(_whole(path, base))) is not None:
                return length + int(more or 0)
        return None

    def compare(self, path: str, name: str, length: int) -> None:
        """Compare an axis with the others of its name."""
        if (expected := self.find(path, name)) is None:
            base, _, more = name.partition("+")
            self._known[_whole(path, base)] = length - int(more or 0)
        elif length != expected:
            raise ValueError(f"{path} has {length} {name}, expected {expected}")

    def check_indices(self) -> None:
        """Raise ValueError for an index that is out of range, and for lanes without a block."""
        lanes, blocks = self._known.get("lanes"), self._known.get("blocks")
        if lanes is not None and blocks is not None and blocks != -(-lanes // WIDTH):
            raise ValueError(f"{lanes} lanes in {blocks} blocks of {WIDTH}")
        for path, array, axes in self.indices:
            end = self.find(path, axes.below or "")
            if end is not None and array.size and not (axes.lowest <= array.min() and array.max() < end):
                raise ValueError(
                    f"{path} points to {array.min()} to {array.max()}, expected {axes.lowest} to {end - 1}"
                )


def _whole(path: str, name: str) -> str:
    return path.split(".")[-2] + name if name.startswith(".") else name


@cache
def _fields(kind: Any) -> list[tuple[Any, Axes | None]]:
    """Return the types and axes of a named tuple's arrays; None for its other fields."""
    fields: list[tuple[Any, Axes | None]] = []
    for name, hint in get_type_hints(kind, include_extras=True).items():
        axes = next((extra for extra in get_args(hint) if isinstance(extra, Axes)), None)
        if axes is None and get_origin(hint) is np.ndarray:
            raise TypeError(f"{kind.__name__}.{name} has no axes")
        fields.append((get_args(get_args(get_args(hint)[0])[1])[0], axes) if axes else (None, None))
    return fields


def aligned_zeros(*shape: int) -> FloatArray:
    """Return zeros that begin where a cache line may: registers across two of them take longer to load."""
    size = math.prod(shape)
    room = np.zeros(size + WIDTH)
    first = -(room.ctypes.data // room.itemsize) % WIDTH
    return room[first : first + size].reshape(shape)


def bound_tick(circuits: Any, observations: FloatArray, commands: FloatArray) -> "partial[object]":
    """Return what advances ``Circuits`` by a control tick.

    It reads observations (inputs, L), which must be finite, and writes commands (outputs, L).
    """
    arguments = structures(
        circuits=circuits,
        observations=(observations, np.float64, Axes("inputs", "lanes")),
        commands=(commands, np.float64, Axes("outputs|motor_channels", "lanes")),
    )
    return partial(required().rover_ncp_tick_lanes, *arguments)


def fill_lanes(circuits: Any, vectors: FloatArray, first: int = 0) -> None:
    """Set lanes of ``Circuits`` from ``first`` on to parameter vectors (k, P), which must lie in bounds."""
    room = len(circuits.parameters.rate) * WIDTH
    if not 0 <= first <= room - len(vectors):
        raise ValueError(f"{len(vectors)} vectors from lane {first} on do not fit into {room} lanes")
    arguments = structures(circuits=circuits, vectors=(vectors, np.float64, Axes("vectors", "parameters")))
    required().rover_ncp_fill_lanes(*arguments, first)


def bound_episodes(circuits: Any, signal_at: NDArray[np.int64], **tuples: Any) -> Callable[[], None]:
    """Return what runs episodes until a group has ended, or until none is left.

    ``signal_at`` (inputs,) gives the signal of each input, a row of ``signals.TABLE``. The others are the
    named tuples of ``rover_ncp_run_episodes``, in its order.
    """
    packed = structures(
        circuits=circuits,
        signal_at=(signal_at, np.int64, Axes("inputs", below=str(required().rover_ncp_signals()))),
        **tuples,
    )
    sizes = (ctypes.c_int64 * len(packed))()
    required().rover_ncp_sizes(sizes)
    if [structure.size for structure in packed] != list(sizes):
        raise TypeError("a named tuple has other fields than its structure in episode.cpp")
    run = partial(required().rover_ncp_run_episodes, *packed, _TICKS_OF_A_CALL)

    def run_all() -> None:
        while not run():
            pass

    return run_all


def bound_submit(queue: Any) -> "partial[int]":
    """Return what lets episodes of a group wait in a ``Queue``.

    It takes the group, the number of episodes, and the addresses of their parameter vectors (n, P) and of
    their thresholds (n,). It returns 1, and none waits, if a parameter is not finite.
    """
    return partial(required().rover_ncp_submit, *structures(queue=queue))


def bound_least_squares(arrays: Any) -> "list[partial[Any]]":
    """Return the functions of least_squares.cpp, in its order, with the arrays that they work on."""
    [structure] = structures(arrays=arrays)
    if structure.size != required().rover_ncp_size_of_least_squares():
        raise TypeError("the named tuple has other fields than its structure in least_squares.cpp")
    names = ("damped_steps", "measure_slopes", "correct_slopes", "survival")
    return [partial(getattr(required(), f"rover_ncp_{name}"), structure) for name in names]


def row_addresses(array: FloatArray, *shape: int) -> range:
    """Return the addresses of an array's rows, for functions that are called often. They live as long as it.

    Raises ValueError for an array of another shape or type, TypeError for one with gaps between its numbers.
    """
    if array.shape != shape or array.dtype is not _FLOAT64:
        raise ValueError(f"{array.dtype} of {array.shape}, expected doubles of {shape}")
    first = ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    return range(first, first + array.nbytes, array.nbytes // shape[0])


@cache
def linear_algebra() -> tuple[int, ...]:
    """Return ``Routines`` of least_squares.cpp: the addresses of functions of scipy's BLAS and LAPACK."""
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    get_name = ctypes.pythonapi.PyCapsule_GetName
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    blas, lapack = _scipy_linalg("cython_blas"), _scipy_linalg("cython_lapack")
    capsules = [*(blas[name] for name in ("dsyrk", "dgemv", "ddot")), lapack["dpotrf"]]
    return tuple(int(get_pointer(capsule, get_name(capsule)) or 0) for capsule in capsules)


def _scipy_linalg(name: str) -> Any:
    """Return the functions of a module of scipy.linalg.

    It is loaded without this package, whose other modules cost each training process 0.1 s and 14 MB.
    """
    import scipy

    spec = PathFinder.find_spec(f"scipy.linalg.{name}", [str(Path(scipy.__file__).parent / "linalg")])
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"scipy {scipy.__version__} has no linalg.{name}")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.__pyx_capi__
