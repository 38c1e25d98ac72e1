"""Shapes seen from above: the rover, an obstacle, an ellipse of doubt."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LENGTH_M, WIDTH_M = 0.626, 0.505
"""A Pioneer 3-AT (its manual, table of specifications)."""
_UNIT = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) / 2
OUTLINE = _UNIT * [LENGTH_M, WIDTH_M]
"""The rover's corners in its own frame, closed, in m."""


def placed(corners: FloatArray, pose: Sequence[float]) -> FloatArray:
    """Return corners (k, 2) of a body's frame where the body is."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    moved: FloatArray = corners @ np.array([[c, s], [-s, c]]) + np.asarray(pose[:2])
    return moved


def rectangle(length: float, width: float, pose: Sequence[float]) -> FloatArray:
    """Return the corners (5, 2) of a rectangle, closed."""
    return placed(_UNIT * [length, width], pose)


def ellipse(covariance: FloatArray) -> tuple[float, float, float]:
    """Return half axes and direction of the ellipse of one standard deviation of a 2 x 2 covariance."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    major, minor = np.sqrt(np.clip(values[::-1], 0.0, None))
    return float(major), float(minor), float(np.arctan2(vectors[1, 1], vectors[0, 1]))
