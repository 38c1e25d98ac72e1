"""Errors of poses from rendered tags, and a noise model fitted to them.

    python benchmarks/tag_noise.py --images 100

Two tags of 0.14 m, 0.3 m apart, at the height of a camera of 640 × 480 pixels with 65° of view. The model is
that of the stack simulation: distance, bearing and turn of the tags err by a + b (d / 3 m)².
"""

import argparse
import math

import cv2
import numpy as np

from deploy.tag.detector import Detector
from deploy.tag.locate import Located, Locator
from deploy.tag.tag_map import CameraFile, Intrinsics, Mount, Tag, TagMap
from rover_ncp.core.geometry import ORIGIN, Pose, compose, inverse, relative, wrap_angle
from sim.camera.render import Renderer

CAMERA = CameraFile(
    intrinsics=Intrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5),
    mount=Mount(x=0.0, y=0.0, z=0.3),
)
TAGS = TagMap(
    tags=tuple(Tag(id=tag, size=0.14, x=0.0, y=y, z=0.3, yaw=math.pi) for tag, y in ((0, 0.15), (1, -0.15)))
)
DISTANCES = (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)
FULL_M = 3.0


def polar(pose: Pose) -> np.ndarray:
    """Return distance, bearing and turn of the tags as seen from a pose."""
    x, y, turn = relative(pose, ORIGIN)
    return np.array([math.hypot(x, y), math.atan2(y, x), turn])


def errors_at(distance: float, images: int, stream: np.random.Generator) -> tuple[np.ndarray, list[float]]:
    """Return errors of distance (m), bearing and turn (rad), and the squared errors in deviations."""
    renderer, detector, locator = Renderer(CAMERA, TAGS, stream), Detector(2.0), Locator(CAMERA, TAGS)
    errors, squares = [], []
    for _ in range(images):
        aside, bearing = stream.uniform(-0.5, 0.5), stream.uniform(-0.25, 0.25)
        away = Pose(-distance * math.cos(aside), distance * math.sin(aside), -aside)
        pose = compose(away, inverse(Pose(0.0, 0.0, bearing)))
        found = locator.locate(detector.detect(renderer.picture(pose)))
        if isinstance(found, Located):
            error = polar(found.pose) - polar(pose)
            error[1:] = [wrap_angle(angle) for angle in error[1:]]
            errors.append(error)
            off = np.array(found.pose) - pose
            off[2] = wrap_angle(off[2])
            squares.append(float(off @ np.linalg.inv(found.covariance) @ off))
    return np.array(errors), squares


def main() -> None:
    """Print the table and the fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    stream = np.random.default_rng(options.seed)
    print("distance   found   sd of distance mm   bearing °   turn °   mean squared error / 3")
    sigmas = []
    for distance in DISTANCES:
        errors, squares = errors_at(distance, options.images, stream)
        # From the middle half, as outliers are no part of a standard deviation of a normal distribution.
        sigma = np.diff(np.quantile(errors, (0.25, 0.75), axis=0), axis=0)[0] / 1.349
        sigmas.append(sigma)
        mm, bearing, turn = sigma * (1000.0, math.degrees(1.0), math.degrees(1.0))
        print(
            f"{distance:6.2f} m {len(errors) / options.images:7.0%} {mm:15.2f} {bearing:14.3f} {turn:9.3f} "
            f"{np.mean(squares) / 3:14.2f}"
        )
    growth = np.column_stack([np.ones(len(DISTANCES)), (np.array(DISTANCES) / FULL_M) ** 2])
    for name, column in zip(("distance m", "bearing rad", "turn rad"), np.array(sigmas).T, strict=True):
        # Relative residuals, so that near distances count as far ones.
        fit = np.linalg.lstsq(growth / column[:, None], np.ones(len(column)), rcond=None)[0]
        worst = np.max(np.abs(growth @ fit / column - 1.0))
        print(f"{name}: {fit[0]:.5f} + {fit[1]:.5f} (d / 3 m)², at most {worst:.0%} from the rendered")


if __name__ == "__main__":
    main()
