"""filterpy's extended Kalman filter, imported without the parts of scipy that it needs for other filters.

``import filterpy`` loads all of them. That would cost a driver 40 MB, and half a second of CPU time before
its first message.
"""

import importlib
import sys
from functools import partial
from types import ModuleType
from typing import Any

import scipy.linalg  # noqa: F401  # before the placeholders, so that no part of scipy ever finds one

_LATER = ("scipy.stats", "scipy.ndimage", "scipy.sparse", "scipy.sparse.linalg")


class _Later:
    """An object of a module that is loaded when something calls the object or a method of it."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    def __getattr__(self, method: str) -> Any:
        return partial(self._call, method)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._call("__call__", *args, **options)

    def _call(self, method: str, *args: Any, **options: Any) -> Any:
        module = importlib.import_module(self._module)
        if isinstance(module, _Placeholder):  # filterpy, while it is imported, tries whether scipy is old
            return None
        return getattr(getattr(module, self._name), method)(*args, **options)


class _Placeholder(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Later(self.__name__, name)


def _import_filter() -> Any:
    """Import filterpy with placeholders for those modules that are not loaded yet."""
    placed = [name for name in _LATER if name not in sys.modules]
    sys.modules.update({name: _Placeholder(name) for name in placed})
    try:
        from filterpy.kalman import ExtendedKalmanFilter

        return ExtendedKalmanFilter
    finally:
        for name in placed:
            del sys.modules[name]


ExtendedKalmanFilter = _import_filter()
