"""The ``bridge`` command: reads its options, runs the loop until a signal comes, reports."""

import signal
from collections.abc import Collection
from pathlib import Path

from pydantic import BaseModel, Field

from bridge.bases import choose_base, gate_limits, open_base
from bridge.inbox import Inbox
from bridge.node import Node
from bridge.ros2 import messages as ros_messages
from bridge.ros2.discovery import Convention
from bridge.zenoh.link import ZenohLink
from rover_ncp.core.console import Output
from rover_ncp.core.interruption import INTERRUPTED
from rover_ncp.core.process import Interrupts, require_open_files

OPEN_FILES = 100
"""Zenoh and the line to the base use about 20, and each driver one: without any left, no driver connects."""


class BridgeResult(BaseModel):
    """Result of the command ``bridge``."""

    zenoh: str = Field(description="the locator for drivers")
    base: str = Field(description="its address")
    bytes_to_base: int = Field(description="those of payloads, if the base is a ROS 2 robot")
    bytes_from_base: int = Field(description="those of payloads, if the base is a ROS 2 robot")
    accepted: int = Field(description="commands that the gate passed")
    dropped: dict[str, int] = Field(description="commands, by reason")
    limited: dict[str, int] = Field(description="commands, by reason")
    stops: dict[str, int] = Field(description="by reason")
    reconnects: int = Field(description="to the base")
    flooded: int = Field(description="messages dropped because too many of their key or topic waited")


def run_bridge(
    *,
    base: str,
    listen: str | None,
    namespace: str,
    model: str,
    limits: Path | None,
    zenoh_config: Path | None,
    base_zenoh_config: Path | None,
    ros: Collection[Convention],
    accept_ros: bool,
    insecure: bool,
    no_base_watchdog: bool,
    as_json: bool,
) -> int:
    """See ``commands.bridge``. Raises UsageError, FileError, ConfigError, PortInUse or NoRobot."""
    require_open_files(OPEN_FILES)
    output = Output(as_json, controls=True)
    chosen = choose_base(base, model, base_zenoh_config)
    allowed = gate_limits(limits, chosen.description)
    inbox = Inbox()
    with (
        Interrupts() as interrupts,
        ZenohLink(listen, namespace, zenoh_config, inbox, insecure=insecure, ros=ros) as link,
    ):
        line, driven, note = open_base(
            chosen,
            allowed,
            inbox,
            link,
            no_base_watchdog=no_base_watchdog,
            interrupted=lambda: interrupts.raised,
            say=output.say,
        )

        def ready() -> None:
            link.announce()
            if note:
                output.say(note)
            output.announce(f"ready zenoh={link.locator} base={base}")

        node = Node(
            driven,
            link,
            inbox,
            limits=allowed,
            accept_ros=accept_ros,
            ready=ready,
        )
        node.run(lambda: interrupts.raised)
    status = ros_messages.gate_status(node.gate)
    result = BridgeResult(
        zenoh=link.locator,
        base=base,
        bytes_to_base=line.bytes_out,
        bytes_from_base=line.bytes_in,
        accepted=status.accepted,
        dropped=status.dropped,
        limited=status.limited,
        stops=status.stops,
        reconnects=max(node.reconnects, 0),
        flooded=inbox.flooded,
    )
    output.result(
        result.model_dump(),
        f"{status.accepted} commands passed, {sum(status.dropped.values())} dropped, "
        f"{sum(status.stops.values())} stops; {line.bytes_out} bytes to the base, {line.bytes_in} from it",
    )
    return INTERRUPTED if signal.SIGINT in interrupts.received else 0
