"""Pictures of tags as a camera would take them: perspective, blur, noise, exposure."""

import cv2
import numpy as np
from numpy.typing import NDArray

from deploy.tag.locate import Locator
from deploy.tag.pattern import CELLS, pattern
from deploy.tag.tag_map import CameraFile, Floats, Tag, TagMap
from rover_ncp.core.geometry import Pose

CELL_PIXELS = 16
"""Pixels of a cell in the texture."""
BORDER_CELLS = 1
"""White cells around the black square."""
FINE = 2
"""Pixels of the finer picture along one of the camera's, so that edges are grey."""
BEHIND = 100.0
"""Corners farther than this from the middle, in focal lengths, are behind the camera or beside it."""
GROUND, PAPER, INK = 95, 225, 25
"""Grey levels of the surroundings, white paper and black ink under normal exposure."""
BLUR_PX, NOISE = 0.7, 3.0
"""Standard deviations: of the blur in pixels, of a pixel in grey levels."""


class Renderer:
    """Renders what one camera sees of one map. ``stream`` draws the noise. Distortion is not simulated.

    ``gain`` multiplies the brightness; 0 is a covered lens.
    """

    def __init__(
        self, camera: CameraFile, tag_map: TagMap, stream: np.random.Generator, gain: float = 1.0
    ) -> None:
        self._intrinsics = camera.intrinsics
        self._size = (camera.intrinsics.width, camera.intrinsics.height)
        self._locator = Locator(camera, tag_map)
        self._tags = [(tag, _texture(tag)) for tag in tag_map.tags]
        self._stream, self.gain = stream, gain

    def picture(self, pose: Pose) -> NDArray[np.uint8]:
        """Return the picture, height × width grey levels, that is taken from a pose of the base."""
        width, height = self._size
        canvas = np.full((height * FINE, width * FINE), GROUND, np.uint8)
        for tag, texture in self._tags:
            self._draw(canvas, tag, texture, np.array(pose))
        picture = np.asarray(cv2.resize(canvas, self._size, interpolation=cv2.INTER_AREA), np.float64)
        picture = self.gain * np.asarray(cv2.GaussianBlur(picture, (0, 0), BLUR_PX), np.float64)
        picture += self._stream.normal(0.0, NOISE, picture.shape)
        return np.clip(np.rint(picture), 0, 255).astype(np.uint8)

    def _draw(self, canvas: NDArray[np.uint8], tag: Tag, texture: NDArray[np.uint8], pose: Floats) -> None:
        edge = (CELLS + 2 * BORDER_CELLS) / CELLS * tag.size
        flat = self._locator.project(pose, tag.model_copy(update={"size": edge}).corners)
        if np.any(np.abs(flat) > BEHIND) or not _faces(flat):
            return
        pixels = self._intrinsics.pixels(flat)
        # From pixel centres of the picture to those of the finer one.
        fine = ((pixels + 0.5) * FINE - 0.5).astype(np.float32)
        side = texture.shape[0]
        square = np.array([[-0.5, side - 0.5], [side - 0.5, side - 0.5], [side - 0.5, -0.5], [-0.5, -0.5]])
        warp = cv2.getPerspectiveTransform(square.astype(np.float32), fine)
        size = (canvas.shape[1], canvas.shape[0])
        cv2.warpPerspective(texture, warp, size, canvas, cv2.INTER_AREA, cv2.BORDER_TRANSPARENT)


def _faces(flat: Floats) -> bool:
    """Return whether a tag's printed side is seen: its corners turn against the clock (y points down)."""
    a, b = flat[1] - flat[0], flat[3] - flat[0]
    return bool(a[0] * b[1] - a[1] * b[0] < 0)


def _texture(tag: Tag) -> NDArray[np.uint8]:
    cells = np.where(pattern(tag.id) > 0, PAPER, INK).astype(np.uint8)
    cells = np.pad(cells, BORDER_CELLS, constant_values=PAPER)
    return np.kron(cells, np.ones((CELL_PIXELS, CELL_PIXELS), np.uint8))
