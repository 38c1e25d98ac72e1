"""AprilTag 3 on grey pictures."""

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np
from apriltag.apriltag import apriltag
from numpy.typing import NDArray

from deploy.tag.tag_map import FAMILY, Floats

MAX_HAMMING = 1
"""Most bits of a code that may be corrected: with more, patterns that are no tags become tags."""
MIN_MARGIN = 20.0
"""Least contrast of the code's bits, in grey levels: below, codes are read out of noise."""


@dataclass(frozen=True)
class Detection:
    """A tag in a picture: corners 4 × 2 in pixels, whole numbers at the centres of pixels, as in OpenCV.

    In order: bottom left, bottom right, top right, top left of the printed tag.
    """

    id: int
    corners: Floats


class Detector:
    """Finds the tags of a picture.

    Making one keeps OpenCV to one thread, as AprilTag: the drive's processes need the others.
    """

    def __init__(self, decimate: float = 1.0) -> None:
        cv2.setNumThreads(1)
        self._detector = apriltag(FAMILY, threads=1, maxhamming=MAX_HAMMING, decimate=decimate)
        self.twice = frozenset[int]()
        """Ids that the last picture shows more than once."""

    def detect(self, image: NDArray[np.uint8]) -> list[Detection]:
        """Return the tags of a grey picture, without ids that are seen twice: neither can be trusted."""
        found = [
            # AprilTag counts from the corner of the first pixel, OpenCV from its centre.
            Detection(int(each["id"]), np.asarray(each["lb-rb-rt-lt"], np.float64) - 0.5)
            for each in self._detector.detect(image)
            if each["margin"] >= MIN_MARGIN
        ]
        seen = Counter(each.id for each in found)
        self.twice = frozenset(each for each, count in seen.items() if count > 1)
        return [each for each in found if each.id not in self.twice]
