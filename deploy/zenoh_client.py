"""Zenoh session of a client of the bridge: its subscriptions, the bridge's answers, its end."""

import logging
import queue
import threading
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from rover_ncp.core.errors import NoBridge, NotAuthorised, UnreachableError
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import BRIDGE, KEYS, KeySpec, Kind, key, spec
from rover_ncp.wire.messages import with_covariance
from rover_ncp.wire.probe import Listener, listener_at
from rover_ncp.wire.zenoh import client_config

_LOGGER = logging.getLogger("rover_ncp")
CALLBACK_S = 1.0
"""Longest wait for the end of a callback."""


@dataclass(frozen=True)
class BridgeAddress:
    """How to reach a bridge: ``--robot``, ``--namespace`` and ``--zenoh-config`` of a command."""

    robot: str
    namespace: str = ""
    zenoh_config: Path | None = None

    @property
    def where(self) -> str:
        """The namespace as a part of an error message."""
        return f" in namespace {self.namespace}" if self.namespace else ""


class ZenohClient(ClosedAtExit):
    """A session with one bridge. It gives every message of the bridge to ``receive``, except ``own`` ones.

    Of the messages that only a bridge sends, those of the process at the address count (`bridge_answer`).
    Behind a router the bridge is another process: then those of all peers count.

    ``receive`` runs in threads of Zenoh, and no more after `close`. Opening raises NoBridge when nothing
    answers at the address, and NotAuthorised when the bridge rejects the session.
    """

    def __init__(
        self, address: BridgeAddress, receive: Callable[[KeySpec, bytes], None], own: Collection[str] = ()
    ) -> None:
        self.address = address
        self.key("odom")  # an invalid namespace is reported before anything is opened
        config, self.robot = client_config(address.robot, address.zenoh_config)
        self.bridge_alive = False
        self._held: list[Any] = []
        self._ending = queue.SimpleQueue[threading.Thread]()
        """The threads of subscriptions that have ended, or are about to."""
        self._receive = receive
        self.complaints: dict[str, str] = {}
        """Why the first message of a topic that was not used could not be."""
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise _refused(self.robot) from error
        self._filter = BridgeFilter(self._session.info.routers_zid)
        try:
            self._declare()
            for row in KEYS:
                if row.kind is Kind.MESSAGE and not row.shown and row.name not in own:
                    self._receive_row(row)
            poses, receive_pose = f"*/{self.key('pose')}/*/*", self._receiving(spec("pose"))
            self._subscribe(self._session.declare_subscriber, poses, receive_pose)  # of rmw_zenoh's nodes
            declare = partial(self._session.liveliness().declare_subscriber, history=True)
            self._subscribe(declare, self.key("rover/alive/bridge"), self._bridge_token_changed)
        except BaseException:
            ZenohClient.close(self)
            raise

    def close(self) -> None:
        """End the session, and wait until no callback runs.

        The threads of callbacks are daemon threads if a daemon thread opened the session. Python does not
        wait for those, and Zenoh's code aborts the process when Python ends one of them.
        """
        self._session.close()  # type: ignore[no-untyped-call]
        with suppress(queue.Empty):
            for _ in self._held:
                self._ending.get(timeout=CALLBACK_S).join(CALLBACK_S)
        self._held.clear()

    def key(self, name: str) -> str:
        """Return the key expression of a row of the table, with the namespace."""
        return key(self.address.namespace, name)

    def bridge_answer(self, replies: Iterable[zenoh.Reply]) -> bytes | None:
        """Return the bridge's answer to a query; None if no queryable takes it.

        The bridge is the process that this session is connected to: other answers are ignored. Behind a
        router it cannot be distinguished from other peers, and has to be the only one that answers. Raises
        NoBridge for several answers, for none in time, and for a refusal. Needs replies without
        consolidation.
        """
        connected, others = self._session.info.routers_zid(), []
        for reply in replies:
            if reply.replier_id is not None and reply.replier_id.zid in connected:
                others = [reply]
                break
            others.append(reply)
        answers = [reply.ok for reply in others if reply.ok is not None]
        if len(answers) > 1:
            raise NoBridge(f"{len(answers)} peers at {self.robot} answer as a bridge, expected one")
        if answers:
            return answers[0].payload.to_bytes()
        if others:
            raise NoBridge(f"the bridge at {self.robot} does not answer in time")
        return None

    def listen(self, names: Collection[str], note: Callable[[str, str, bytes], None]) -> None:
        """Call ``note`` with key expression, publisher's id and content of each message that is received.

        It is called once for each message, and in the order of a publisher for the keys of ``names``.
        """
        own = {self.key(name) for name in names}

        def receive(sample: zenoh.Sample) -> None:
            note(str(sample.key_expr), source_of(sample), sample.payload.to_bytes())

        def receive_other(sample: zenoh.Sample) -> None:
            # Each subscription has a thread: a message from both would be old when the slower one shows it.
            if str(sample.key_expr) not in own:
                receive(sample)

        # Access control rejects the first, and a peer in another namespace then cannot send either.
        self._subscribe(self._session.declare_subscriber, "**", receive_other)
        for key_expr in own:
            self._subscribe(self._session.declare_subscriber, key_expr, receive)

    def _declare(self) -> None:
        """Declare what a subclass sends, before the first message arrives."""

    def _receive_row(self, row: KeySpec) -> None:
        self._subscribe(self._session.declare_subscriber, self.key(row.name), self._receiving(row))

    def _subscribe(
        self, declare: Callable[..., Any], key_expr: str, callback: Callable[[zenoh.Sample], None]
    ) -> None:
        handler = zenoh.handlers.Callback(callback, lambda: self._ending.put(threading.current_thread()))
        self._held.append(declare(key_expr, handler))

    def _receiving(self, row: KeySpec) -> Callable[[zenoh.Sample], None]:
        def receive(sample: zenoh.Sample) -> None:
            data = sample.payload.to_bytes()
            if len(data) > row.max_bytes:
                self._complain(row, f"{len(data)} bytes, expected at most {row.max_bytes}")
                return
            source = None if sample.source_info is None else sample.source_info.source_id.zid
            if not self._filter.accepts(row, source):
                self._complain(row, f"another peer than the bridge at {self.robot} sent it")
                return
            self._receive(row, with_covariance(data) if row.name == "pose" else data)

        return receive

    def _complain(self, row: KeySpec, why: str) -> None:
        if row.name not in self.complaints:
            _LOGGER.info(f"a message on '{row.name}' is not used: {why}")
        self.complaints.setdefault(row.name, why)

    def _bridge_token_changed(self, sample: zenoh.Sample) -> None:
        self.bridge_alive = sample.kind == zenoh.SampleKind.PUT


class BridgeFilter:
    """Accepts the messages that only a bridge sends from the process at the address alone.

    ``connected`` returns the ids of that process. Behind a router the bridge has another id: until a message
    of the process at the address comes, those of all peers count.
    """

    def __init__(self, connected: Callable[[], Collection[object]]) -> None:
        self._look_up = connected
        self._connected: Collection[object] = ()
        self._is_bridge = False
        """Whether the process at the address has sent a message that only a bridge sends."""

    def accepts(self, row: KeySpec, source: object | None) -> bool:
        """Return whether a message of the peer ``source`` counts; None is a peer that states no id."""
        if row.senders != BRIDGE or row.latched:
            return True
        if source is not None and source not in self._connected:
            self._connected = self._look_up()
        if source in self._connected:
            self._is_bridge = True
        return source in self._connected or not self._is_bridge


def source_of(sample: zenoh.Sample) -> str:
    """Return the id of a sample's publisher, else of the process that stamped it first; "" without either."""
    if sample.source_info is not None:
        return str(sample.source_info.source_id.zid)
    return "" if sample.timestamp is None else f"stamped by {sample.timestamp.get_id()}"


def matches(declared: Any) -> bool:
    """Return whether a subscriber or queryable exists for a publisher or querier."""
    # Zenoh's stub declares a bool; the returned object is always truthy.
    return bool(declared.matching_status.matching)


def _refused(endpoint: str) -> UnreachableError:
    """Return the error for a failed session. Zenoh reports an unused port and a rejection alike."""
    found = listener_at(endpoint)
    if found is Listener.NOTHING:
        return NoBridge(
            f"nothing answers at {endpoint}: is 'rover-ncp bridge' running there, listening on that address?"
        )
    if found is Listener.OLD_ZENOH:
        return NoBridge(f"{endpoint}: {found}; a bridge of rover-ncp has Zenoh 1")
    return NotAuthorised(
        f"not authorised: the process at {endpoint} accepts no session from us; it may want a certificate "
        "(--zenoh-config, see 'rover-ncp keys'), or its clock is wrong and our certificate invalid by it, or "
        "it is no bridge, or hangs"
    )
