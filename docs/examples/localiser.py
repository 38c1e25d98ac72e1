"""Stands in for a camera: publishes the true pose of a mock, with noise, on 'pose'.

    python localiser.py TRUTH.CSV [ROBOT] [FRAME]

ROBOT is the bridge's address, tcp/127.0.0.1:7447 by default, FRAME the frame of the poses, map by default.
"""

import sys
import time
from pathlib import Path

import numpy as np
import zenoh

from rover_ncp.core.geometry import Pose
from rover_ncp.robot.lasting_error import Declaration, Kind
from rover_ncp.wire.messages import pose_with_covariance, text

NOISE = np.array([0.003, 0.003, 0.005])
"""Standard deviations of x and y in m, and of the heading in rad."""


def main(truth: str, robot: str = "tcp/127.0.0.1:7447", frame: str = "map") -> None:
    """Publish a pose eight times a second until Ctrl-C."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{robot}"]')
    lasting = text(Declaration(kind=Kind.MOTION_CAPTURE, frame=frame).model_dump_json())
    noise = np.random.default_rng()
    with zenoh.open(config) as session, Path(truth).open() as lines:
        names = lines.readline().split(",")
        last = ""
        print(f"publishing on 'pose' at {robot}, frame {frame}; Ctrl-C ends it", flush=True)
        while True:
            for line in lines:
                last = line if line.endswith("\n") else last
            row = dict(zip(names, last.split(","), strict=False))
            if "theta" in row:
                pose = np.array([float(row[name]) for name in Pose._fields]) + noise.normal(size=3) * NOISE
                data = pose_with_covariance(Pose(*pose), np.diag(NOISE**2), time.time_ns(), frame)
                session.put("rover/localiser", lasting)
                session.put("pose", data)
            time.sleep(0.125)


if __name__ == "__main__":
    main(*sys.argv[1:])
