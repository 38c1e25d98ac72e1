"""A camera's intrinsics as other programs write them.

ROS's camera_calibration (YAML), ``ros2 topic echo camera_info``, and OpenCV's FileStorage (YAML).
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deploy.tag.tag_map import Intrinsics
from rover_ncp.core.config import read_yaml, validated
from rover_ncp.core.errors import ConfigError
from rover_ncp.core.files import read_text

MODELS = {
    "plumb_bob": "pinhole",
    "rational_polynomial": "pinhole",
    "thin_prism": "pinhole",
    "pinhole": "pinhole",
    "equidistant": "fisheye",
    "fisheye": "fisheye",
    "kannala_brandt4": "fisheye",
}
"""Names of distortion models."""
NAMES: Mapping[str, Sequence[str]] = {
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
    "k": ("camera_matrix", "k"),
    "d": ("distortion_coefficients", "d"),
}
"""What programs call a picture's size, the camera matrix and the distortion."""
EXPECTED = (
    "expected a calibration of ROS (ost.yaml, or 'ros2 topic echo --once camera_info'), or of OpenCV in "
    "YAML, with image_width, image_height, camera_matrix and distortion_coefficients"
)


def load_camera_info(path: Path) -> Intrinsics:
    """Read intrinsics from a file. Raises FileError and ConfigError."""
    text, source = read_text(path), str(path)
    text = re.sub(r"^%YAML.*$|!!opencv[\w-]*", "", text, flags=re.MULTILINE)  # OpenCV's own
    # A topic's messages end with a line of dashes.
    documents = [each for each in re.split(r"^---.*$", text, flags=re.MULTILINE) if each.strip()]
    if not documents or text.lstrip().startswith(("# oST", "<")):
        raise ConfigError(source, [EXPECTED])
    data = read_yaml(documents[0], source)
    if not isinstance(data, dict):
        raise ConfigError(source, [EXPECTED])
    given = {name: _first(data, names) for name, names in NAMES.items()}
    try:
        size = int(given["width"]), int(given["height"])
        k, d = _numbers(given["k"]), _numbers(given["d"])
    except (TypeError, ValueError, KeyError, OverflowError) as error:
        missing = [NAMES[name][0] for name, value in given.items() if value is None]
        words = f"no {', '.join(missing)}" if missing else f"not numbers: {error}"
        raise ConfigError(source, [f"{words}; {EXPECTED}"]) from error
    return camera_info(size, k, str(data.get("distortion_model") or ""), d, source)


def camera_info(
    size: tuple[int, int], k: Sequence[float], model: str, distortion: Sequence[float], source: str
) -> Intrinsics:
    """Return intrinsics from the fields of ROS's CameraInfo. Raises ConfigError."""
    if len(k) != 9:
        raise ConfigError(source, [f"a camera matrix of {len(k)} numbers, expected 9"])
    if not any(k):
        raise ConfigError(source, ["the camera matrix is all zero: the camera is not calibrated"])
    if not np.allclose(np.array(k)[[1, 3, 6, 7, 8]], [0.0, 0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise ConfigError(source, ["camera matrix: expected fx, 0, cx, 0, fy, cy, 0, 0, 1"])
    if not model and not len(distortion):
        model, distortion = "plumb_bob", (0.0,) * 5  # a camera of a simulator
    if not model and len(distortion) == 4:
        raise ConfigError(
            source,
            ["4 coefficients without distortion_model: add it, plumb_bob or equidistant (a fisheye's)"],
        )
    if model and model not in MODELS:
        raise ConfigError(source, [f"distortion_model {model}: expected one of {', '.join(MODELS)}"])
    return validated(
        {
            **{"width": size[0], "height": size[1], "fx": k[0], "cx": k[2], "fy": k[4], "cy": k[5]},
            "model": MODELS.get(model, "pinhole"),
            "distortion": tuple(distortion) or (0.0,) * (4 if MODELS.get(model) == "fisheye" else 5),
        },
        Intrinsics,
        source,
    )


def _first(data: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((data[name] for name in names if data.get(name) is not None), None)


def _numbers(value: Any) -> list[float]:
    """Return the numbers of a matrix: a list, a list of rows, or a mapping with ``data``."""
    found = np.array(value["data"] if isinstance(value, Mapping) else value, np.float64)
    return [float(each) for each in found.ravel()]
