"""The bridge's answers to queries: motors, stop, odometry reset."""

from collections.abc import Callable

from bridge.gate_state import Enable, Event, Reason, Release, State, Stop, Unlatch, Verdict
from bridge.inbox import Asked
from bridge.limits import Limits
from bridge.link import Link
from bridge.session import Session
from rover_ncp.core.errors import FormatError
from rover_ncp.core.lease import (
    MotorsReply,
    MotorsRequest,
    ResetReply,
    ResetRequest,
    StopReply,
    StopRequest,
    parse_json,
)

__all__ = ["Answers"]

_WORDS = {
    Reason.NO_BASE: "the base is not connected",
    Reason.STOP_BUTTON: "the STOP button is pressed",
    Reason.BUMPER: "a bumper is pressed",
    Reason.STALL: "a motor is stalled",
    Reason.LOW_BATTERY: "the battery is low",
    Reason.ODOMETRY: "the base does not report where it is",
    Reason.FROZEN: "the base reports the same place while it says that it drives",
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
                    request = parse_json(MotorsRequest, asked.payload)
                    self._link.answer(asked, self._motors(request, now, gate))
                case "rover/stop":
                    self._link.answer(asked, self._stop(parse_json(StopRequest, asked.payload), now))
                case _:
                    parse_json(ResetRequest, asked.payload)
                    self._link.answer(asked, self._reset(gate))
        except FormatError as error:
            self._link.refuse(asked, str(error))

    def _motors(self, request: MotorsRequest, now: float, gate: State) -> MotorsReply:
        driver, limits = bytes.fromhex(request.driver), self._limits
        if not request.enable:
            self._judge(Release(driver), now)
            return MotorsReply(granted=False)
        refusal = self._judge(Enable(driver, request.name, request.sent_ns), now).refusal
        if refusal is not None:
            return MotorsReply(granted=False, reason=str(refusal), detail=_detail(refusal, gate))
        return MotorsReply(
            granted=True,
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
            return ResetReply(ok=False, reason="somebody is driving: a pose that jumps would confuse it")
        self._session.reset_odometry()
        return ResetReply(ok=True)


def _detail(refusal: Reason, gate: State) -> str:
    if refusal is Reason.ANOTHER_DRIVER and gate.lease is not None:
        return f"{gate.lease.name or gate.lease.driver.hex()} has the motors"
    if refusal is Reason.STOPPED:
        return f"stopped until released: {gate.latched or 'no reason given'}"
    return _WORDS.get(refusal, "")
