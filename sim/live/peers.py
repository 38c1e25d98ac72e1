"""Zenoh sessions with a thread of their own, for programs that act as a driver, a localiser or a bridge."""

import threading
import time
from typing import Any, Self

import numpy as np
import zenoh

from rover_ncp.core.geometry import Pose
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import key
from rover_ncp.wire.messages import COURSE_FRAME, pose_with_covariance, read_text
from rover_ncp.wire.protocol import GateStatus, parse_json
from rover_ncp.wire.zenoh import client_config

KNOWN_M, KNOWN_RAD = 0.001, 0.001
"""Standard deviations of a start pose."""
PERIOD_S = 0.1


class Peer(ClosedAtExit):
    """A Zenoh session and a thread that runs `run`, from `start` or the beginning of the ``with`` block on.

    `close`, or the end of the block, sets ``closing`` and waits for the thread.
    """

    def __init__(self, config: zenoh.Config) -> None:
        self.session = zenoh.open(config)
        self.closing = threading.Event()
        self._thread = threading.Thread(target=self.run, name=type(self).__name__, daemon=True)

    def run(self) -> None:
        """Do the peer's work until ``closing`` is set."""
        raise NotImplementedError

    def start(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def close(self) -> None:
        """End the thread and the session."""
        self.closing.set()
        if self._thread.is_alive():
            self._thread.join()
        session: Any = self.session
        session.close()

    def __enter__(self) -> Self:
        return self.start()


def known_pose(pose: Pose, wall_ns: int) -> bytes:
    """Return the external pose of a rover that was placed to the millimetre."""
    return pose_with_covariance(
        pose, np.diag(np.square([KNOWN_M, KNOWN_M, KNOWN_RAD])), wall_ns, COURSE_FRAME
    )


class StartPosePublisher(Peer):
    """External localisation of a rover that stands at ``pose``, until a driver has the lease."""

    def __init__(self, robot: str, pose: Pose) -> None:
        super().__init__(client_config(robot, None)[0])
        self._pose = pose
        self._gate = self.session.declare_subscriber(key("", "rover/gate"), self._receive_gate)

    def run(self) -> None:
        """Publish the pose ten times a second."""
        while not self.closing.wait(PERIOD_S):
            self.session.put(key("", "pose"), known_pose(self._pose, time.time_ns()))

    def _receive_gate(self, sample: zenoh.Sample) -> None:
        if parse_json(GateStatus, read_text(sample.payload.to_bytes())).lease:
            self.closing.set()
