"""filterpy's extended Kalman filter, imported without scipy.stats.

``import filterpy`` loads scipy.stats for likelihoods, which no filter here computes. That would cost a driver
39 MB, and half a second of CPU time before its first message.
"""

import importlib
import sys
from functools import partial
from types import ModuleType
from typing import Any


class _Distribution:
    """A distribution of scipy.stats, which loads scipy.stats when something calls it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, method: str) -> Any:
        return partial(self._call, method)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._call("__call__", *args, **options)

    def _call(self, method: str, *args: Any, **options: Any) -> Any:
        stats = importlib.import_module("scipy.stats")
        if getattr(stats, self._name) is self:  # filterpy, while it is imported, tries whether scipy is old
            return None
        return getattr(getattr(stats, self._name), method)(*args, **options)


def _import_filter() -> Any:
    """Import filterpy with such distributions in place of scipy.stats, unless one of both is loaded."""
    if {"filterpy", "scipy.stats"}.isdisjoint(sys.modules):
        stats: Any = ModuleType("scipy.stats")
        stats.norm, stats.multivariate_normal = _Distribution("norm"), _Distribution("multivariate_normal")
        sys.modules["scipy.stats"] = stats
        try:
            importlib.import_module("filterpy.kalman")
        finally:
            del sys.modules["scipy.stats"]
    return importlib.import_module("filterpy.kalman").ExtendedKalmanFilter


ExtendedKalmanFilter = _import_filter()
