"""The session of a localiser with a bridge."""

import math
import time
from collections.abc import Mapping

import zenoh

from deploy.zenoh_client import BridgeAddress, ZenohClient, matches
from rover_ncp.robot.lasting_error import Declaration, Kind
from rover_ncp.wire.key_table import KEYS, TAG_OUTLINES, TAG_VIEW
from rover_ncp.wire.messages import text

DECLARED_S = 0.5
"""Time between two declarations: a driver that waits for a standstill of 1 s receives one."""


class PoseLink(ZenohClient):
    """A session with a bridge that sends poses and pictures, and receives nothing."""

    def __init__(self, address: BridgeAddress, frame: str) -> None:
        """``frame`` is that of the poses."""
        self._lasting_error = text(Declaration(kind=Kind.TAGS, frame=frame).model_dump_json())
        super().__init__(address, lambda row, data: None, own=[row.name for row in KEYS])

    def _declare(self) -> None:
        self._publisher = self._session.declare_publisher(self.key("pose"))
        self._lasting = self._session.declare_publisher(self.key("rover/localiser"))
        self._declared_s = -math.inf
        # A picture never delays a pose, nor anything else on the way.
        self._shown = {
            name: self._session.declare_publisher(
                self.key(name),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.BACKGROUND,
            )
            for name in (TAG_VIEW, TAG_OUTLINES)
        }

    def send(self, pose: bytes) -> None:
        """Send a pose with the moment of its measurement, and what is known of the poses' errors."""
        if (now := time.monotonic()) - self._declared_s >= DECLARED_S:
            self._declared_s = now
            self._lasting.put(self._lasting_error)
        self._publisher.put(pose)

    @property
    def watched(self) -> bool:
        """Whether a page or a recording receives pictures."""
        return matches(self._shown[TAG_VIEW])

    def show(self, messages: Mapping[str, bytes]) -> None:
        """Send a picture for people, and what is beside it, by the names of their keys."""
        for name, data in messages.items():
            self._shown[name].put(data)
