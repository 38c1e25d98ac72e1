"""The driver's side of its lease: signs messages, and tracks the commands that the gate has not accepted.

Rules of this file:

1. The key stays in this object: it is in no message, log or recording.
2. A gate status may end a drive. It never starts one, and it never replaces the key.
"""

from collections import deque

from rover_ncp.core.errors import SafetyStop
from rover_ncp.wire.protocol import REASONS, CommandTag, GateStatus, MotorsReply, Signed

NOT_ACCEPTED = "not-accepted"
ACCEPTED_S = 0.4
"""Time limit for the gate to accept a command. Checked at least every 0.1 s, so a driver stops in 0.5 s."""
MAX_PENDING = 1000
"""Maximum number of pending commands: no driver sends so many in `ACCEPTED_S`."""


class DriverLease:
    """The lease of one driver; its number is 0 without one. Times are the driver's monotonic clock, in ns."""

    def __init__(self) -> None:
        self.number = 0
        self._secret = b""
        self._sequence = 0
        self._pending: deque[tuple[int, int]] = deque(maxlen=MAX_PENDING)
        self._dropped: dict[str, int] = {}

    def grant(self, reply: MotorsReply) -> None:
        """Store the lease of a granted request. The answer to a renewal holds no key and changes nothing."""
        if reply.key:
            self.number, self._secret = reply.lease, bytes.fromhex(reply.key)
            self._pending.clear()

    def end(self) -> None:
        """Forget the lease and its key."""
        self.number, self._secret = 0, b""
        self._pending.clear()

    def sign(self, kind: Signed, key_expr: str, payload: bytes, now_ns: int) -> CommandTag:
        """Return the tag of a message with the next sequence number."""
        tag = CommandTag(self.number, self._sequence, now_ns).sign(self._secret, kind, key_expr, payload)
        self._sequence += 1
        if kind is Signed.COMMAND:
            self._pending.append((tag.sequence, now_ns))
        return tag

    def check(self, gate: GateStatus, now_ns: int) -> None:
        """Raise SafetyStop if the gate has not accepted a command in time, with its reasons since then."""
        answered = gate.sequence if gate.lease == self.number else -1
        if not self._pending or self._pending[0][0] <= answered:
            self._dropped = gate.dropped
        while self._pending and self._pending[0][0] <= answered:
            self._pending.popleft()
        if not self._pending:
            return
        age_s = (now_ns - self._pending[0][1]) * 1e-9
        if age_s <= ACCEPTED_S:
            return
        growth = {reason: count - self._dropped.get(reason, 0) for reason, count in gate.dropped.items()}
        reasons = ", ".join(
            f"{reason} {count} ({REASONS.get(reason, reason)})"
            for reason, count in growth.items()
            if count > 0
        )
        raise SafetyStop(
            NOT_ACCEPTED,
            f"the gate accepted no command of this driver for {age_s:.2f} s (limit {ACCEPTED_S} s); "
            + (f"dropped since then: {reasons}" if reasons else "it reports no dropped command"),
        )
