"""A viewer's Zenoh session: receives everything, commands nothing, and may request a stop."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh

from deploy.drive.zenoh_config import client_config, refused
from rover_ncp.core.errors import FormatError, NoBridge, NotAuthorised
from rover_ncp.core.key_table import KEYS, Kind, key, spec
from rover_ncp.core.protocol import StopReply, StopRequest, dump_json, parse_json
from rover_ncp.core.recording import Recorded

STOP_TIMEOUT_S = 1.0
REASON = "the Stop button of a viewer"


class Viewer:
    """One session with one bridge. Opening it raises NoBridge or NotAuthorised."""

    def __init__(
        self, robot: str, namespace: str, zenoh_config: Path | None, hear: Callable[[Recorded], None]
    ) -> None:
        self._namespace = namespace
        self._hear = hear
        self._key("odom")  # a bad namespace is said before anything is opened
        config, self.robot = client_config(robot, zenoh_config)
        self.bridge_alive = False
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise refused(self.robot) from error
        try:
            self._subscribers = [
                self._session.declare_subscriber(self._key(row.name), self._hearing(row.name))
                for row in KEYS
                if row.kind is Kind.MESSAGE
            ]
            self._token = self._session.liveliness().declare_subscriber(
                self._key("rover/alive/bridge"), self._token_changed, history=True
            )
            self._stopper = self._session.declare_querier(self._key("rover/stop"), timeout=STOP_TIMEOUT_S)
        except BaseException:
            self._session.close()  # type: ignore[no-untyped-call]
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    @property
    def may_stop(self) -> bool:
        """Whether a bridge takes our stop: one that we may not stop does not show its queryable."""
        # The object is truthy whatever it says, and Zenoh's stub takes it for a bool.
        status: Any = self._stopper.matching_status
        return bool(status.matching)

    def stop(self, release: bool = False) -> StopReply:
        """Stop the rover until released, or release it.

        Raises NotAuthorised when the bridge does not accept it from us, NoBridge when there is no bridge or
        no readable answer.
        """
        request = StopRequest(release=release, reason="" if release else REASON)
        for reply in self._stopper.get(payload=dump_json(request)):
            if reply.ok is None:
                raise NoBridge(f"the bridge at {self.robot} does not answer within {STOP_TIMEOUT_S:g} s")
            try:
                return parse_json(StopReply, reply.ok.payload.to_bytes())
            except FormatError as error:
                raise NoBridge(f"the bridge at {self.robot} sends an unreadable answer: {error}") from error
        if not self.bridge_alive:
            raise NoBridge(f"no bridge shows itself at {self.robot}: nothing to stop")
        raise NotAuthorised(f"not authorised to stop: the bridge at {self.robot} accepts no stop from us")

    def _key(self, name: str) -> str:
        return key(self._namespace, name)

    def _hearing(self, name: str) -> Callable[[zenoh.Sample], None]:
        ros_type, limit = spec(name).type, spec(name).max_bytes

        def hear(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            if len(data) <= limit:
                now = time.time_ns()
                with contextlib.suppress(FormatError):
                    self._hear(Recorded(name, ros_type, data, now, now))

        return hear

    def _token_changed(self, sample: zenoh.Sample) -> None:
        self.bridge_alive = sample.kind == zenoh.SampleKind.PUT
