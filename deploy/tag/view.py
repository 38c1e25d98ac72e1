"""What a localiser's camera sees, for people: pictures with outlined tags, and the outlines as numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deploy.tag.detector import Detection
from rover_ncp.wire.cdr import encode
from rover_ncp.wire.key_table import TAG_OUTLINES, TAG_VIEW, spec
from rover_ncp.wire.message_parts import header_of

SENT_WIDTH = 640
"""Largest width of a picture that is sent, pixels."""
SENT_QUALITIES = 70, 40, 10
"""Of the JPEG of a picture that is sent: the next one if the picture is larger than its key allows."""
GREEN, RED, YELLOW = (0, 200, 0), (0, 0, 255), (0, 255, 255)
"""In OpenCV's order: blue, green, red."""
LINE_LOOP = 2
"""Type of a `foxglove_msgs/PointsAnnotation` that is a closed polygon."""


@dataclass(frozen=True)
class View:
    """A picture, the tags in it, the localiser's pose or its reason for none, and when it was taken."""

    grey: NDArray[np.uint8]
    tags: Sequence[Detection]
    words: str
    wall_ns: int

    def jpeg(self, quality: int = 95) -> bytes:
        """Return a JPEG with the tags outlined and a line of words."""
        canvas = cv2.cvtColor(self.grey, cv2.COLOR_GRAY2BGR)
        for each in self.tags:
            corners = np.rint(each.corners).astype(np.int32)
            cv2.polylines(canvas, [corners], isClosed=True, color=GREEN, thickness=2)
            where = (int(corners[3, 0]), int(corners[3, 1]) - 6)
            cv2.putText(canvas, str(each.id), where, cv2.FONT_HERSHEY_SIMPLEX, 0.6, RED, 2)
        text = self.words.replace("θ", "theta").encode("ascii", "replace").decode()
        where = (8, self.grey.shape[0] - 10)
        cv2.putText(canvas, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.45, YELLOW, 1)
        return bytes(cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())

    def messages(self) -> dict[str, bytes]:
        """Return the picture, not wider than `SENT_WIDTH`, and its outlines, by the names of their keys."""
        small = self._small()
        row, header = spec(TAG_VIEW), header_of(self.wall_ns, "camera")
        for quality in SENT_QUALITIES:
            jpeg = np.frombuffer(small.jpeg(quality), np.uint8)
            picture = encode(row.type, header=header, format="jpeg", data=jpeg)
            if len(picture) <= row.max_bytes:
                return {TAG_VIEW: picture, TAG_OUTLINES: small.outlines()}
        return {}

    def _small(self) -> "View":
        scale = SENT_WIDTH / self.grey.shape[1]
        if scale >= 1.0:
            return self
        grey = cv2.resize(self.grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        # Whole numbers are the centres of pixels.
        tags = [Detection(each.id, scale * (each.corners + 0.5) - 0.5) for each in self.tags]
        return View(np.asarray(grey, np.uint8), tags, self.words, self.wall_ns)

    def outlines(self) -> bytes:
        """Return the tags as ImageAnnotations, which viewers of recordings draw over the picture."""
        stamp, green = header_of(self.wall_ns, "")["stamp"], {"g": GREEN[1] / 255, "a": 1.0}
        points, texts = list[dict[str, Any]](), list[dict[str, Any]]()
        for each in self.tags:
            # Here whole numbers are the upper left corners of pixels.
            corners = [{"x": x, "y": y} for x, y in (each.corners + 0.5).tolist()]
            loop = {"type": LINE_LOOP, "points": corners, "outline_color": green, "thickness": 2.0}
            label = {"position": corners[3], "text": str(each.id), "font_size": 16.0, "text_color": green}
            points.append({"timestamp": stamp, **loop})
            texts.append({"timestamp": stamp, **label})
        return encode(spec(TAG_OUTLINES).type, points=points, texts=texts)
