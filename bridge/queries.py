"""The bridge's answers to queries: motors, stop, base.

While a lease is held, a request for the motors counts only with a valid digest under that lease's key. The
digest is verified before the request is parsed. The key is in the answer to a new driver, and nowhere else.
"""

import math
import secrets
from collections.abc import Callable
from importlib.metadata import version

from pydantic import BaseModel

from bridge.base import Base, base_failures
from bridge.gate.limits import Limits
from bridge.gate.state import (
    Enable,
    GateEvent,
    GateState,
    Reason,
    Release,
    ReleaseStop,
    Stop,
    Verdict,
    describe,
    read_tag,
)
from bridge.inbox import Query
from rover_ncp.core.bridge_lines import LEASE_OF, STOP_REQUESTED
from rover_ncp.core.errors import FormatError
from rover_ncp.wire.protocol import (
    KEY_BYTES,
    BaseReply,
    BaseRequest,
    MotorsReply,
    MotorsRequest,
    Signed,
    StopReply,
    StopRequest,
    dump_json,
    parse_json,
)

UNCHECKED = "unchecked"


class Answers:
    """Answers for the loop, which passes requests on to the gate by ``judge(event, now)``.

    ``key`` is the key expression of a name, ``wall_ns`` the wall clock at a moment of the monotonic one, and
    ``log`` notes a line for people.
    """

    def __init__(
        self,
        limits: Limits,
        key: Callable[[str], str],
        judge: Callable[[GateEvent, float], Verdict],
        base: Base,
        *,
        wall_ns: Callable[[float], int],
        log: Callable[[str], None],
    ) -> None:
        self._key, self._judge, self._base = key, judge, base
        self.limits = limits
        """Those of the gate, which the base may tighten once it is known."""
        self._wall_ns, self._log = wall_ns, log
        self._versions = version("rover-ncp"), version("eclipse-zenoh")
        self.model = ""
        """Model of the base, once it is ready."""
        self.problem = ""
        """Why the base is lost."""

    def give(self, query: Query, now: float, gate: GateState) -> None:
        """Answer one query that arrived at ``now``; ``gate`` is the state before it."""
        try:
            query.reply(dump_json(self._answer(query, now, gate)))
        except FormatError as error:
            query.refuse(str(error))

    def _answer(self, query: Query, now: float, gate: GateState) -> BaseModel:
        """Return the answer. Raises FormatError for a request that cannot be read."""
        match query.name:
            case "rover/motors":
                return self._motors(query, now, gate)
            case "rover/stop":
                return self._stop(query, now)
            case _:
                return self._about_base(query, now, gate)

    def _motors(self, query: Query, now: float, gate: GateState) -> MotorsReply:
        tag, lease = read_tag(query.attachment), gate.lease
        signed = lease is not None and lease.signed(tag, Signed.MOTORS, self._key(query.name), query.payload)
        if lease is not None and not signed:
            return _refusal(Reason.ANOTHER_DRIVER, gate)
        request = parse_json(MotorsRequest, query.payload)
        sequence = tag.sequence if signed else None
        if not request.enable:
            if sequence is not None:
                self._judge(Release(sequence), now)
            return MotorsReply()
        with base_failures():
            refusal = self._base.base_timeout.refusal
        if refusal:
            return MotorsReply(reason=UNCHECKED, detail=refusal)
        secret = secrets.token_bytes(KEY_BYTES)
        verdict = self._judge(Enable(request.name, request.sent_ns, secret, sequence), now)
        if verdict.refusal is not None:
            return _refusal(verdict.refusal, gate)
        assert verdict.lease is not None  # it was granted
        if sequence is None:
            self._log(f"{LEASE_OF}{_who(query)}")
        key = secret.hex() if verdict.lease.secret == secret else ""
        return MotorsReply(granted=True, lease=verdict.lease.number, key=key)

    def _stop(self, query: Query, now: float) -> StopReply:
        try:
            request = parse_json(StopRequest, query.payload)
        except FormatError:
            # Only a request that can be read may release. This one most likely was to stop the rover.
            self._judge(Stop("a request that cannot be read"), now)
            self._log(f"{_who(query)}{STOP_REQUESTED} by a request that cannot be read")
            raise
        stop = f"{STOP_REQUESTED}: {request.reason or 'no reason'}"
        self._log(f"{_who(query)}{' requests the release of the stop' if request.release else stop}")
        self._judge(ReleaseStop() if request.release else Stop(request.reason), now)
        return StopReply(stopped=not request.release, reason="" if request.release else request.reason)

    def _about_base(self, query: Query, now: float, gate: GateState) -> BaseReply:
        parse_json(BaseRequest, query.payload)
        with base_failures():
            known, health = self._base.base_timeout, self._base.health()
        (own, zenoh), nan, report = self._versions, math.nan, gate.base
        ahead, behind = (nan, nan) if report is None else (report.clear_ahead_m, report.clear_behind_m)
        return BaseReply(
            model=self.model,
            battery_min_v=self.limits.battery_min_v,
            state=known.state,
            timeout_s=known.timeout_s,
            unheard=health.unheard,
            clock=health.clock,
            problem=self.problem or (report.hazard_unknown if report is not None else ""),
            version=own,
            zenoh=zenoh,
            wall_ns=self._wall_ns(now),
            room_m=(_finite(ahead), _finite(behind)),
        )


def _who(query: Query) -> str:
    """Return the sender of a request in words. Only certificates prove who it is."""
    return f"the peer with the Zenoh id {query.source}" if query.source else "a peer that states no Zenoh id"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _refusal(refusal: Reason, gate: GateState) -> MotorsReply:
    detail = describe(refusal, gate)
    if refusal is Reason.STOPPED:
        detail = f"stopped until released, by {detail}"
    return MotorsReply(reason=str(refusal), detail=detail)
