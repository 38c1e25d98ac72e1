"""The bridge's Zenoh session: a router inside this process, which needs no other server.

Callbacks only put arrivals into the inbox. Publishing never blocks: a message that cannot leave at once is
dropped.
"""

import json
import os
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from bridge.inbox import CommandMessage, Inbox, Query
from bridge.ros2.discovery import Convention, bridge_token, topic_token
from bridge.ros2.rmw import domain_id
from bridge.ros2.ros_node import RosNode, declare_publisher
from bridge.zenoh.config import any_port, configured
from rover_ncp.core.errors import PortInUse, UsageError
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.wire.key_table import KEYS, KeySpec, Kind, Role, key, spec
from rover_ncp.wire.protocol import TAG_BYTES
from rover_ncp.wire.zenoh import reason


class ZenohLink(ClosedAtExit):
    """An open session, listening. Raises UsageError, FileError (``config``) or PortInUse.

    Beyond this machine it requires authentication, unless ``insecure``. ``ros`` selects the form in which ROS
    nodes look for the topics; the domain of rmw_zenoh is that of ROS_DOMAIN_ID.
    """

    def __init__(
        self,
        listen: str | None,
        namespace: str,
        config: Path | None,
        inbox: Inbox,
        *,
        insecure: bool = False,
        ros: Collection[Convention] = (Convention.ROS2DDS,),
    ) -> None:
        self._inbox = inbox
        self._namespace = namespace
        self._ros = ros
        self._rmw: RosNode | None = None
        self._sequence = 0
        # Raises for a bad namespace before anything is opened.
        settings, endpoints = configured(listen, config, insecure, self.key("cmd_vel"))
        if Convention.RMW_ZENOH in ros:
            # ROS nodes find each other through the router they are connected to, which we are then.
            settings.insert_json5("scouting/gossip/enabled", "true")
        self._session = _open(settings, endpoints)
        self._held: list[Any] = []
        try:
            self.locator = self._locator(endpoints)
            """The endpoint it listens on, with the port it got."""
            self._declare()
        except BaseException:
            self.close()
            raise

    def announce(self) -> None:
        """Announce the bridge, and its topics to ROS bridges."""
        tokens = self._session.liveliness()
        if Convention.ROS2DDS in self._ros:
            self._held += [tokens.declare_token(key) for key in self._ros2dds_tokens()]
        if self._rmw is not None:
            self._rmw.announce()
        self._held.append(tokens.declare_token(self.key("rover/alive/bridge")))

    def watch_robot_side(self, key: str, seen: Callable[[bool], None]) -> None:
        """Call ``seen`` when a token of the robot's network appears here or goes: the two are connected."""
        on_token = self._inbox.guarded(lambda sample: seen(sample.kind == zenoh.SampleKind.PUT))
        self._held.append(self._session.liveliness().declare_subscriber(key, on_token, history=True))

    def _ros2dds_tokens(self) -> list[str]:
        # A token of cmd_vel names one type: the ROS bridge would make a reader of that one, and would pass on
        # neither the other type nor a warning. Without a token it takes the type of each publisher.
        zid = str(self._session.info.zid())
        rows = [row for row in KEYS if row.name in self._publishers]
        topics = [topic_token(zid, self.key(row.name), row.type, True, row.latched) for row in rows]
        return [bridge_token(zid), *topics]

    def publish(self, name: str, data: bytes) -> None:
        """Send a message on a key of the table."""
        if name not in self._publishers:  # poses, of which only some robots have any
            self._publishers[name] = declare_publisher(self._session, self.key(name))
            self._marked.add(name)
        publisher = self._publishers[name]
        if name in self._marked:
            self._sequence = (self._sequence + 1) % 2**32
            publisher.put(data, source_info=zenoh.SourceInfo(publisher.id, self._sequence))
        else:
            publisher.put(data)
        if self._rmw is not None and name in self._rmw_publishers:
            self._rmw_publishers[name].put(data)

    def close(self) -> None:
        """End the session; the token goes with it."""
        self._session.close()  # type: ignore[no-untyped-call]

    def key(self, name: str) -> str:
        """Return the key expression of a row of the table, with the namespace."""
        return key(self._namespace, name)

    def _declare(self) -> None:
        ours = [row for row in KEYS if row.senders == {Role.BRIDGE} and row.kind is Kind.MESSAGE]
        self._publishers = {
            row.name: declare_publisher(self._session, self.key(row.name), row.latched) for row in ours
        }
        # By this id drivers notice others that publish our topics. Latched messages cannot have it.
        self._marked = {row.name for row in ours if not row.latched}
        self._held.append(
            self._session.declare_subscriber(self.key("cmd_vel"), self._inbox.guarded(self._command))
        )
        for row in KEYS:
            if row.kind is Kind.QUERYABLE:
                on_query = self._inbox.guarded(partial(self._query, row))
                self._held.append(self._session.declare_queryable(self.key(row.name), on_query))
        if Convention.RMW_ZENOH in self._ros:
            self._rmw = RosNode(
                self._session, Convention.RMW_ZENOH, domain=domain_id(os.environ), namespace=self._namespace
            )
            self._rmw_publishers = {
                row.name: self._rmw.publisher(row.name, row.type, row.latched) for row in ours
            }

    def _command(self, sample: zenoh.Sample) -> None:
        # Of a command that is too long, one byte too many: the loop digests no megabytes.
        payload = sample.payload.to_bytes()[: spec("cmd_vel").max_bytes + 1]
        self._inbox.put(CommandMessage(payload, _bytes(sample.attachment)))

    def _query(self, row: KeySpec, query: zenoh.Query) -> None:
        def reply(answer: bytes) -> None:
            with query:  # a client that is gone is ignored
                query.reply(self.key(row.name), answer, encoding=zenoh.Encoding.APPLICATION_JSON)

        def refuse(reason: str) -> None:
            with query:
                query.reply_err(reason)

        # A get("**") only reads. A request that names the stop, such as "*/rover/stop", is meant.
        asked, key = str(query.key_expr), self.key(row.name)
        if asked != key and not (row.name == "rover/stop" and asked.endswith("/stop")):
            refuse(f"'{asked}' is not the key {key}")
            return
        payload = query.payload
        # One byte too many is enough for the reader to refuse it.
        data = b"{}" if payload is None else payload.to_bytes()[: row.max_bytes + 1]
        info = query.source_info
        source = "" if info is None else str(info.source_id.zid)
        self._inbox.put(Query(row.name, data, _bytes(query.attachment), reply, refuse, source))

    def _locator(self, endpoints: list[str]) -> str:
        """Return the first endpoint; for port 0, ask the session which one it got."""
        if not any_port(endpoints):
            return endpoints[0].partition("#")[0]
        for reply in self._session.get(f"@/{self._session.info.zid()}/router", timeout=1.0):
            if reply.ok is not None:
                return str(json.loads(reply.ok.payload.to_string())["locators"][0])
        raise UsageError(f"--listen {endpoints[0]}: the chosen port is unknown; give a port number")


def _bytes(attachment: zenoh.ZBytes | None) -> bytes | None:
    # One byte too many, and it is no tag.
    return None if attachment is None else attachment.to_bytes()[: TAG_BYTES + 1]


def _open(settings: zenoh.Config, endpoints: list[str]) -> zenoh.Session:
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        where = ", ".join(endpoints)
        if "already in use" in str(error):
            raise PortInUse(f"--listen {where}: another process listens there already") from error
        raise UsageError(f"--listen {where}: cannot listen there: {reason(error)}") from error
