"""The client's side of an ARCOS connection: bytes in, events out, time passed in.

Rules of this file:

1. The state changes only as ``states.TABLE`` says.
2. Only ``tick``, ``receive`` and the explicit calls send; keep-alives come from ``tick`` alone. Calls from
   outside the safety gate's loop would defeat the base's watchdog.
3. A base resumes its old setpoints with any packet that reaches it, SYNC0 included. So connecting begins by
   listening: a base that sends packets then has an open session, and gets zero setpoints first.
4. Setpoints are zero before ENABLE, after a loss, and until the motors were requested and are on.

Sources: AROS manual p. 43 (motors, watchdog); ``states.py`` for the handshake.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from bridge.base import BaseEvent, BaseReport, Failed, Lost, Notice, Ready, Recovered, TurnRate
from bridge.pioneer import states
from bridge.pioneer.framing import HOSTBAUD_RATES, Command, Decoder, Packet, encode_command
from bridge.pioneer.odometry import ROBOTS, Odometer
from bridge.pioneer.packets import SIP_KINDS, ConfigPac, GyroPac, Kind, Sip, decode_names
from bridge.pioneer.setpoints import MotionLimits, Setpoints
from bridge.pioneer.states import Input, SessionState
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import RobotDescription

_PACKET_INPUTS: dict[int, Input] = {
    Kind.SYNC0: Input.ECHO0,
    Kind.SYNC1: Input.ECHO1,
    Kind.CONFIG: Input.CONFIG,
    Kind.RESET_FE: Input.RESET,
    Kind.RESET_FF: Input.RESET,
}


@dataclass(frozen=True)
class BaudChanged:
    """The serial line must run at this rate before anything more is sent."""

    baudrate: int


SessionEvent: TypeAlias = BaseEvent | BaudChanged


class Session:
    """One base on one line. Without a ``robot`` it is the one of ``ROBOTS`` that it reports.

    Times are seconds on any clock that does not go back.
    """

    def __init__(self, robot: RobotDescription | None = None, limits: MotionLimits | None = None) -> None:
        self.state = SessionState.IDLE
        self.decoder = Decoder()
        """Its counters show the quality of the link."""
        self._chosen = robot
        self._setpoints = Setpoints(limits or MotionLimits(), self._send)
        # Replaced when the base has sent its name.
        self._odometer = Odometer(ROBOTS[DEFAULT_ROBOT])
        self._names = ("", "", "")
        self._report: BaseReport | None = None
        self._config: ConfigPac | None = None
        self._gyro_seen = False
        self._out = bytearray()
        self._events: list[SessionEvent] = []
        self._reason = ""
        self._now = self._deadline = self._opened_s = self._asked_s = 0.0
        self._began_s = 0.0
        self._tries = self._silent_tries = 0
        self._silent_limit = states.SILENT_TRIES
        self._bytes_in = self._packets_before = 0
        self._rate: int | None = None
        """Rate of the serial line; None on a line without one."""
        self._opened_rate: int | None = None

    # Calls of the base's owner.

    def connect(self, now: float, baudrate: int | None = None) -> None:
        """Begin to connect on a line opened at ``baudrate``, which is None for a line without a rate."""
        self._now = now
        self._rate = self._opened_rate = baudrate
        self._dispatch(Input.CONNECT)

    def close(self, now: float) -> None:
        """Stop the base, switch its motors off, end the session. Nothing is sent after these packets."""
        self._now = now
        self._dispatch(Input.CLOSE)

    def link_down(self, reason: str, now: float) -> list[SessionEvent]:
        """Process the loss of the line; ``connect`` begins anew on the next one."""
        self._now, self._reason = now, reason
        self._dispatch(Input.LINK_DOWN)
        self._out.clear()
        return self._drain()

    def receive(self, data: bytes, now: float) -> list[SessionEvent]:
        """Parse bytes from the base and return the events."""
        self._now = now
        self._bytes_in += len(data)
        self._decode(data)
        return self._drain()

    def tick(self, now: float) -> list[SessionEvent]:
        """Let time pass: clocks, setpoints, keep-alives. Call it from the gate's loop, 20 times a second."""
        self._now = now
        self._decode(b"")
        if now - self._began_s >= states.CONNECT_S:
            self._dispatch(Input.GAVE_UP)
        if now >= self._deadline:
            self._dispatch(Input.EXPIRED)
        if self.state is SessionState.READY:
            self._setpoints.tick(self._report, now)
            if self._odometer.config is None and now - self._asked_s >= states.CONFIG_S:
                self._ask_for_config()
        return self._drain()

    def data_to_send(self) -> bytes:
        """Return the bytes for the base and forget them."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def set_motion(self, velocity: Velocity) -> None:
        """Set the speeds that the next tick sends; zero unless the motors were requested."""
        self._setpoints.set_motion(velocity)

    @property
    def watchdog_s(self) -> float | None:
        """Time after which the base halts without packets, by its configuration; None before that arrives."""
        return None if self._config is None else self._config.watchdog / 1000.0

    @property
    def gyro_silent(self) -> bool:
        """Whether the base has a gyro that has sent nothing."""
        return self._config is not None and self._config.sends_gyro and not self._gyro_seen

    # Only a ready base gets requests: nothing moves before the first packet from the base.

    def enable(self, on: bool) -> None:
        """Ask for the motors, or switch them off, standing still either way."""
        if self.state is SessionState.READY:
            self._setpoints.enable(on, self._now)

    def emergency_stop(self) -> None:
        """Stop at once, beyond the deceleration limit."""
        if self.state is SessionState.READY:
            self._setpoints.emergency_stop(self._now)

    # The machine.

    def _decode(self, data: bytes) -> None:
        for packet in self.decoder.feed(data, self._now):
            what = self._classify(packet)
            if what is not None:
                self._silent_tries = 0
                self._dispatch(what)

    def _dispatch(self, what: Input) -> None:
        entry = states.TABLE[self.state].get(what)
        if entry is None:
            return
        state, action = entry
        if state is not None:
            self.state = state
            self._deadline = self._now + states.PATIENCE_S[state]
        if isinstance(action, Command):
            self._send(action)
        elif action is not None:
            self.ACTIONS[action](self)

    def _drain(self) -> list[SessionEvent]:
        events, self._events = self._events, []
        return events

    def _send(self, command: Command, argument: int | None = None) -> None:
        self._out += encode_command(command, argument)

    def _classify(self, packet: Packet) -> Input | None:
        """Store a packet's content and return its input; None for a packet that a session does not use."""
        if packet.kind in SIP_KINDS:
            if (sip := Sip.decode(packet)) is None:
                return None
            self._sip = sip
            return Input.SIP
        if packet.kind == Kind.SYNC2:
            self._names = decode_names(packet.payload)
            return Input.STRANGER if self._robot() is None or self._contradicts() else Input.NAMES
        # Before its session a base may send what the one before was still owed.
        opened = self.state in {SessionState.CONFIGURING, SessionState.READY, SessionState.LOST}
        if packet.kind == Kind.CONFIG and opened:
            self._config = ConfigPac.decode(packet.payload)
        if packet.kind == Kind.GYRO and self.state is SessionState.READY:
            self._gyro_seen = True
            rate = GyroPac.decode(packet.payload).rate
            if rate is not None:
                self._events.append(TurnRate(rate))
        return _PACKET_INPUTS.get(packet.kind)

    def _robot(self) -> RobotDescription | None:
        return self._chosen or ROBOTS.get(self._names[2].lower())

    def _contradicts(self) -> bool:
        """Whether the base's name is that of another shipped model than the chosen one: of other units.

        A user's own description may be of a base with any name.
        """
        reported, chosen = self._names[2].lower(), self._chosen
        return chosen is not None and chosen.name != reported and {chosen.name, reported} <= set(ROBOTS)

    # Actions.

    def _listen(self) -> None:
        self._out.clear()
        self.decoder.drop()
        self._began_s = self._now
        self._tries = self._silent_tries = 0
        self._bytes_in, self._packets_before = 0, self.decoder.packets

    def _sync0(self) -> None:
        self._tries += 1
        self._send(Command.PULSE)

    def _try_again(self) -> None:
        self._silent_tries += 1
        opened = self._opened_rate
        rates = () if opened is None else tuple(dict.fromkeys((opened, states.FAST_RATE)))
        if self._silent_tries >= self._silent_limit + len(rates):
            self._dispatch(Input.GAVE_UP)
        elif self._silent_tries > states.POLITE_TRIES:
            if rates:
                self._change_baud(rates[self._silent_tries % len(rates)])
            # The answer to SYNC2 may have been lost: then a session waits for OPEN and echoes nothing.
            self._send(Command.CLOSE)

    def _give_up(self) -> None:
        valid = self.decoder.packets - self._packets_before
        if valid:
            reason = (
                f"the base answers, but no handshake was completed within {self._now - self._began_s:.0f} s"
            )
        elif self._bytes_in:
            reason = (
                f"the device that answers is no ARCOS base, or the baud rate is wrong: "
                f"{self._bytes_in} bytes, not one valid packet"
            )
        else:
            reason = f"no answer to {self._tries} handshakes"
        self._events.append(Failed(reason))

    def _hang_up(self) -> None:
        self._send_zeros()
        self._send(Command.CLOSE)

    def _open(self) -> None:
        robot = self._robot()
        assert robot is not None  # or this was a STRANGER
        self._odometer = Odometer(robot)
        self._report = self._config = None
        self._gyro_seen = False
        self._opened_s = self._now
        self._send(Command.OPEN)
        self._ask_for_config()

    def _refuse(self) -> None:
        self._send(Command.CLOSE)
        remedy = f"give its model with --model: one of {', '.join(ROBOTS)}"
        if self._chosen is not None:
            remedy = f"leave out --model {self._chosen.name}, or describe the robot in a file"
        self._events.append(Failed(f"the base calls itself {self._names[2]!r}; {remedy}"))

    def _first_sip(self) -> None:
        self._report = self._odometer.update(self._sip, self._now)
        if self._config is not None:
            self._settle(self._config)

    def _configure(self) -> None:
        assert self._config is not None  # it has just arrived
        first, self._odometer.config = self._odometer.config is None, self._config
        if self.state is SessionState.READY:
            if first:
                self._ask_for_gyro()
        elif self._report is not None:
            self._settle(self._config)

    def _ask_again(self) -> None:
        waited = self._now - self._opened_s
        if self._report is None:
            if waited > states.OPEN_S:
                self._dispatch(Input.GAVE_UP)
                return
            self._send(Command.OPEN)
        elif waited > states.CONFIG_S:
            self._dispatch(Input.SETTLED)
            return
        if self._config is None:
            self._ask_for_config()

    def _ask_for_config(self) -> None:
        self._send(Command.CONFIG)
        self._asked_s = self._now

    def _ask_for_gyro(self) -> None:
        if self._config is not None and self._config.sends_gyro:
            self._send(Command.GYRO, 1)

    def _settle(self, config: ConfigPac) -> None:
        switches = config.autobaud == states.CAN_SWITCH
        slow = self._rate is not None and self._rate < states.FAST_RATE
        self._dispatch(Input.SLOW if switches and slow else Input.SETTLED)

    def _ask_faster(self) -> None:
        self._send(Command.HOSTBAUD, HOSTBAUD_RATES.index(states.FAST_RATE))

    def _switch(self) -> None:
        self._change_baud(states.FAST_RATE)
        # The change cut all buffered bytes, and the base needs a packet at the new rate.
        self.decoder.drop()
        self._send(Command.PULSE)

    def _switch_back(self) -> None:
        assert self._opened_rate is not None  # it was below the fast rate
        self._change_baud(self._opened_rate)
        self.decoder.drop()
        self._be_ready()

    def _change_baud(self, baudrate: int) -> None:
        if baudrate != self._rate:
            self._rate = baudrate
            self._events.append(BaudChanged(baudrate))

    def _be_ready(self) -> None:
        self._silent_limit = states.TRIES_AGAIN
        name, robot_class, subtype = self._names
        self._events.append(Ready(f"{robot_class} {subtype} {name}", self._odometer.robot))
        if self._odometer.config is None:
            self._events.append(Notice(states.NO_CONFIG))
        self._setpoints.take(self._now)
        self._ask_for_gyro()

    def _publish(self) -> None:
        self._report = self._odometer.update(self._sip, self._now)
        self._events.append(self._report)

    def _lose(self) -> None:
        self._send_zeros()
        self._events.append(Lost(f"no odometry from the base for {states.LOSS_S} s"))

    def _replace_line(self) -> None:
        self._events.append(Failed("no packet from the base since it was lost"))

    def _recover(self) -> None:
        self._events.append(Recovered())
        self._setpoints.take(self._now)
        self._publish()

    def _lose_to_reset(self) -> None:
        self._listen()
        self._events.append(Lost("the base was reset"))

    def _lose_line(self) -> None:
        self._events.append(Lost(self._reason))

    def _leave(self) -> None:
        self._send_zeros()
        self._send(Command.ENABLE, 0)
        self._send(Command.CLOSE)

    def _send_zeros(self) -> None:
        self._send(Command.VEL, 0)
        self._send(Command.RVEL, 0)
        self._send(Command.STOP)

    ACTIONS: ClassVar[dict[str, Callable[["Session"], None]]] = {
        "listen": _listen,
        "sync0": _sync0,
        "try_again": _try_again,
        "give_up": _give_up,
        "hang_up": _hang_up,
        "open": _open,
        "refuse": _refuse,
        "first_sip": _first_sip,
        "configure": _configure,
        "ask_again": _ask_again,
        "ask_faster": _ask_faster,
        "switch": _switch,
        "switch_back": _switch_back,
        "be_ready": _be_ready,
        "publish": _publish,
        "lose": _lose,
        "replace_line": _replace_line,
        "recover": _recover,
        "lose_to_reset": _lose_to_reset,
        "lose_line": _lose_line,
        "leave": _leave,
    }
    """Functions of the actions in ``states.TABLE``."""
