"""The request for a stop: a session that may stop the rover, and the command ``stop``."""

import threading
from collections.abc import Callable
from contextlib import suppress

import zenoh
from pydantic import Field

from deploy.zenoh_client import BridgeAddress, ZenohClient, matches
from rover_ncp.core.config import ResultModel
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FormatError, NoBridge, NotAuthorised, UnreachableError
from rover_ncp.wire.key_table import KeySpec
from rover_ncp.wire.messages import read_odometry
from rover_ncp.wire.protocol import StopReply, StopRequest, dump_json, parse_json

STOP_TIMEOUT_S = 1.0
STANDS_M_S, STANDS_RAD_S = 0.005, 0.01
STANDS_S = 3.0
"""Longest wait for odometry that shows a standstill."""


class StopClient(ZenohClient):
    """A session with one bridge that may stop its rover; ``reason`` names who stops it.

    Raises as `ZenohClient`.
    """

    def __init__(
        self, address: BridgeAddress, receive: Callable[[KeySpec, bytes], None], reason: str
    ) -> None:
        self._reason = reason
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
        request = StopRequest(release=release, reason="" if release else self._reason)
        source = zenoh.SourceInfo(self._stopper.id, 0)  # for the bridge's log
        answer = self.bridge_answer(self._stopper.get(payload=dump_json(request), source_info=source))
        if answer is not None:
            try:
                return parse_json(StopReply, answer)
            except FormatError as error:
                raise NoBridge(f"the bridge at {self.robot} sends an unreadable answer: {error}") from error
        if not self.bridge_alive:
            raise NoBridge(f"no bridge shows itself at {self.robot}: nothing to stop")
        raise NotAuthorised(f"not authorised to stop: the bridge at {self.robot} accepts no stop from us")


class StopResult(ResultModel):
    """Result of the command ``stop``."""

    robot: str = Field(description="the bridge's address")
    confirmed: bool = Field(description="whether the bridge confirmed what was requested")
    stands: bool | None = Field(description="by odometry after a stop; null if none came, or for a release")
    problem: str = Field(description="why nothing was confirmed")


def run(address: BridgeAddress, output: Output, *, release: bool) -> int:
    """See ``commands.stop``; return the exit code."""
    stands, moving = threading.Event(), threading.Event()

    def receive(row: KeySpec, data: bytes) -> None:
        if row.name == "odom":
            with suppress(FormatError):
                speed = read_odometry(data).velocity
                still = abs(speed.v) < STANDS_M_S and abs(speed.omega) < STANDS_RAD_S
                (stands if still else moving).set()
                (moving if still else stands).clear()

    try:
        with StopClient(address, receive, "rover-ncp stop") as client:
            reply = client.stop(release)
            if reply.stopped == release:
                raise NoBridge(f"the bridge at {address.robot} answers the opposite of what was requested")
            if not release:
                for event in (stands, moving):  # what came before the stop says nothing
                    event.clear()
                stands.wait(STANDS_S)
    except UnreachableError as error:
        lost = "" if release else "; the robot may drive on: press its stop button"
        words = f"no confirmation of the {'release' if release else 'stop'}: {error}{lost}"
        output.result(
            StopResult(robot=address.robot, confirmed=False, stands=None, problem=str(error)), words
        )
        return 1
    found = None if release or not (stands.is_set() or moving.is_set()) else stands.is_set()
    state = {None: "no odometry came", True: "odometry shows that the robot stands"}
    if release:
        words = f"the bridge at {address.robot} released the stop: drivers may request the motors"
    else:
        seen = state.get(found, f"odometry still shows motion after {STANDS_S:g} s: press its stop button")
        words = (
            f"the bridge at {address.robot} confirms the stop; {seen}. It lasts until 'rover-ncp stop "
            "--release'"
        )
    output.result(StopResult(robot=address.robot, confirmed=True, stands=found, problem=""), words)
    return 0
