"""What is printed of a tag: black and white cells."""

import cv2
import numpy as np
from numpy.typing import NDArray

CELLS = 8
"""Cells along the edge of a tag's black square; the white border around it is one cell more on each side."""


def pattern(tag: int) -> NDArray[np.uint8]:
    """Return a tag's 8 × 8 cells, 0 black and 255 white, the way AprilTag 3 counts its corners."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # OpenCV's tags of this family stand on their heads.
    return np.rot90(cv2.aruco.generateImageMarker(family, tag, CELLS), 2).astype(np.uint8)
