"""A viewer's Zenoh session: receives everything, commands nothing, and may request a stop."""

import contextlib
import time
from collections.abc import Callable

import zenoh

from deploy.zenoh_client import BridgeAddress, ZenohClient, matches
from rover_ncp.core.errors import FormatError, NoBridge, NotAuthorised
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.key_table import KeySpec
from rover_ncp.wire.protocol import StopReply, StopRequest, dump_json, parse_json

STOP_TIMEOUT_S = 1.0
REASON = "the live page's Stop button"


class Viewer(ZenohClient):
    """One session with one bridge; ``take`` gets every message. Raises as `ZenohClient`."""

    def __init__(self, address: BridgeAddress, take: Callable[[Recorded], None]) -> None:
        def receive(row: KeySpec, data: bytes) -> None:
            now = time.monotonic_ns()
            with contextlib.suppress(FormatError):
                take(Recorded(row.name, row.type, data, now, now))

        super().__init__(address, receive)

    def _declare(self) -> None:
        self._stopper = self._session.declare_querier(
            self.key("rover/stop"),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=STOP_TIMEOUT_S,
        )

    @property
    def may_stop(self) -> bool:
        """Whether a bridge takes our stop: it hides its queryable from users without permission."""
        return matches(self._stopper)

    def stop(self, release: bool = False) -> StopReply:
        """Stop the rover until released, or release it.

        Raises NotAuthorised when the bridge does not accept it from us, NoBridge when there is no bridge or
        no readable answer.
        """
        request = StopRequest(release=release, reason="" if release else REASON)
        answer = self.bridge_answer(self._stopper.get(payload=dump_json(request)))
        if answer is not None:
            try:
                return parse_json(StopReply, answer)
            except FormatError as error:
                raise NoBridge(f"the bridge at {self.robot} sends an unreadable answer: {error}") from error
        if not self.bridge_alive:
            raise NoBridge(f"no bridge shows itself at {self.robot}: nothing to stop")
        raise NotAuthorised(f"not authorised to stop: the bridge at {self.robot} accepts no stop from us")
