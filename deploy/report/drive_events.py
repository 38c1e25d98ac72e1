"""Events of a drive, from changes in the status of driver and gate."""

from typing import NamedTuple

from rover_ncp.core.protocol import DriverStatus, GateStatus


class Event(NamedTuple):
    """Something worth a line; ``kind`` is state, start, gate, stop or late."""

    wall_ns: int
    kind: str
    text: str


class Watcher:
    """Compares each status with the one before and notes the changes."""

    def __init__(self) -> None:
        self.status: DriverStatus | None = None
        self.gate: GateStatus | None = None
        self.events: list[Event] = []

    def driver(self, wall_ns: int, now: DriverStatus) -> None:
        """Hear the driver."""
        before, self.status = self.status, now
        if before is None or now.state != before.state:
            reason = f": {now.reason}" if now.reason else ""
            self.events.append(
                Event(wall_ns, "stop" if now.state == "fault" else "state", now.state + reason)
            )
        if before is not None and now.overruns > before.overruns:
            self.events.append(Event(wall_ns, "late", f"tick {now.tick} was late"))

    def bridge(self, wall_ns: int, now: GateStatus) -> None:
        """Hear the gate."""
        before, self.gate = self.gate or GateStatus(), now
        # Before its first command a rover is held by design.
        if now.held and now.held != before.held and now.accepted:
            words = f": {now.stop_reason}" if now.stop_reason else ""
            self.events.append(Event(wall_ns, "stop", f"the gate holds the rover, {now.held}{words}"))
        if before.held and not now.held and before.accepted:
            self.events.append(Event(wall_ns, "gate", "the gate passes commands again"))
        if now.ended and now.ended != before.ended:
            self.events.append(Event(wall_ns, "stop", f"the gate revoked the lease, {now.ended}"))
        for what, then, counts in (
            ("dropped a command", before.dropped, now.dropped),
            ("limited a command", before.limited, now.limited),
        ):
            # The first of a kind is news, the rest is a number in the summary.
            self.events += [
                Event(wall_ns, "gate", f"the gate {what} for the first time, {reason}")
                for reason in counts
                if reason not in then
            ]
