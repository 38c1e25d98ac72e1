"""The bridge's answers to queries: motors, stop, odometry reset.

While a lease is held, a request for the motors counts only with a valid digest under that lease's key. The
digest is verified before the request is parsed. The key is in the answer to a new driver, and nowhere else.
"""

import secrets
from collections.abc import Callable

from bridge.gate.limits import Limits
from bridge.gate.signatures import is_signed, read_tag
from bridge.gate.state import Enable, Event, Lease, Reason, Release, State, Stop, Unlatch, Verdict
from bridge.inbox import Asked
from bridge.pioneer.session import Session
from bridge.zenoh_link import Link
from rover_ncp.core.errors import FormatError
from rover_ncp.core.protocol import (
    KEY_BYTES,
    PROTOCOL,
    VERSION_REASON,
    MotorsRefusal,
    MotorsReply,
    MotorsRequest,
    ResetReply,
    ResetRequest,
    Signed,
    StopReply,
    StopRequest,
    other_version,
    parse_json,
    requested_version,
)

_WORDS = {
    Reason.NO_BASE: "the base is not connected",
    Reason.STOP_BUTTON: "the STOP button is pressed",
    Reason.BUMPER: "a bumper is pressed",
    Reason.STALL: "a motor is stalled",
    Reason.LOW_BATTERY: "the battery is low",
    Reason.ODOMETRY: "the base reports no pose, or its odometry is stale",
    Reason.FROZEN: "the base reports the same pose while it reports a speed",
    Reason.REPEATED: "this renewal of the lease, or a later message, has arrived already",
}


class Answers:
    """Answers for the loop, which passes requests on to the gate by ``judge(event, now)``."""

    def __init__(
        self, link: Link, session: Session, limits: Limits, judge: Callable[[Event, float], Verdict]
    ) -> None:
        self._link, self._session, self._limits, self._judge = link, session, limits, judge

    def give(self, asked: Asked, now: float, gate: State) -> None:
        """Answer one query that arrived at ``now``; ``gate`` is the state before it."""
        try:
            match asked.name:
                case "rover/motors":
                    self._link.answer(asked, self._motors(asked, now, gate))
                case "rover/stop":
                    self._link.answer(asked, self._stop(parse_json(StopRequest, asked.payload), now))
                case _:
                    parse_json(ResetRequest, asked.payload)
                    self._link.answer(asked, self._reset(gate))
        except FormatError as error:
            self._link.refuse(asked, str(error))

    def _motors(self, asked: Asked, now: float, gate: State) -> MotorsRefusal:
        """Answer a request for the motors. Raises FormatError for one that cannot be read."""
        tag = read_tag(asked.attachment)
        signed = is_signed(tag, gate.lease, Signed.MOTORS, self._link.key(asked.name), asked.payload)
        if gate.lease is not None and not signed:
            return _refusal(Reason.ANOTHER_DRIVER, gate)
        if (version := requested_version(asked.payload)) != PROTOCOL:
            return MotorsRefusal(reason=VERSION_REASON, detail=other_version(PROTOCOL, version))
        request = parse_json(MotorsRequest, asked.payload)
        sequence = tag.sequence if tag is not None and signed else None
        if not request.enable:
            if sequence is not None:
                self._judge(Release(sequence), now)
            return MotorsRefusal()
        secret = secrets.token_bytes(KEY_BYTES)
        verdict = self._judge(Enable(request.name, request.sent_ns, secret, sequence), now)
        if verdict.refusal is not None:
            return _refusal(verdict.refusal, gate)
        assert verdict.lease is not None  # it was granted
        return self._grant(verdict.lease, new=verdict.lease.secret == secret, now=now)

    def _grant(self, lease: Lease, new: bool, now: float) -> MotorsReply:
        limits = self._limits
        return MotorsReply(
            granted=True,
            lease=lease.number,
            key=lease.secret.hex() if new and lease.secret is not None else "",
            lease_s=limits.lease_s,
            received_ns=round(now * 1e9),
            limits={
                "v": limits.v_max,
                "omega": limits.omega_max,
                "accel": limits.accel,
                "alpha": limits.alpha,
            },
        )

    def _stop(self, request: StopRequest, now: float) -> StopReply:
        self._judge(Unlatch() if request.release else Stop(request.reason), now)
        return StopReply(stopped=not request.release, reason="" if request.release else request.reason)

    def _reset(self, gate: State) -> ResetReply:
        if gate.base is None:
            return ResetReply(ok=False, reason=_WORDS[Reason.NO_BASE])
        if gate.lease is not None:
            return ResetReply(
                ok=False,
                reason="a driver holds the lease: its pose would jump; reset odometry after the drive",
            )
        self._session.reset_odometry()
        return ResetReply(ok=True)


def _refusal(refusal: Reason, gate: State) -> MotorsRefusal:
    detail = _WORDS.get(refusal, "")
    if refusal is Reason.ANOTHER_DRIVER and gate.lease is not None:
        detail = f"{gate.lease.name or 'a driver without a name'} holds the lease"
    elif refusal is Reason.STOPPED:
        detail = f"stopped until released: {gate.latched or 'no reason given'}"
    return MotorsRefusal(reason=str(refusal), detail=detail)
