"""External localisation of a mock: publishes its start pose on ``pose`` until a driver has the lease."""

import threading
import time
from types import TracebackType
from typing import Any, Self

import numpy as np
import zenoh

from deploy.zenoh_client import client_config
from rover_ncp.core.geometry import Pose
from rover_ncp.core.key_table import key
from rover_ncp.core.messages import COURSE_FRAME, pose_with_covariance, read_text
from rover_ncp.core.protocol import GateStatus, parse_json

KNOWN_M, KNOWN_RAD = 0.001, 0.001
PERIOD_S = 0.1


def known_pose(pose: Pose, wall_ns: int) -> bytes:
    """Return the external pose of a rover that was placed to the millimetre."""
    return pose_with_covariance(
        pose, np.diag(np.square([KNOWN_M, KNOWN_M, KNOWN_RAD])), wall_ns, COURSE_FRAME
    )


class Placed:
    """Publishes at a bridge that the rover stands at ``pose``, until a driver has the lease."""

    def __init__(self, robot: str, pose: Pose) -> None:
        self._robot, self._pose = robot, pose
        self._over = threading.Event()

    def __enter__(self) -> Self:
        config, _ = client_config(self._robot, None)
        self._session = zenoh.open(config)
        self._publisher = self._session.declare_publisher(key("", "pose"))
        self._gate = self._session.declare_subscriber(key("", "rover/gate"), self._gate_spoke)
        self._thread = threading.Thread(target=self._publish, name="placed", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()
        closing: Any = self._session
        closing.close()

    def _publish(self) -> None:
        while not self._over.wait(PERIOD_S):
            self._publisher.put(known_pose(self._pose, time.time_ns()))

    def _gate_spoke(self, sample: zenoh.Sample) -> None:
        if parse_json(GateStatus, read_text(sample.payload.to_bytes())).lease:
            self._over.set()
