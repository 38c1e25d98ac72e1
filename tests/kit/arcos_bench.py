"""A session with a simulated peer, which records the bytes sent and the events."""

from typing import Self

from bridge.pioneer.framing import Command, Decoder, Packet, encode_frame
from bridge.pioneer.odometry import ROBOTS
from bridge.pioneer.packets import ConfigPac, Sip, encode_names
from bridge.pioneer.session import Session, SessionEvent
from bridge.pioneer.states import PATIENCE_S, Input, SessionState
from sim.base.client_commands import decode_argument

Sent = list[tuple[Command, object]]


def frame(packet: Packet) -> bytes:
    return encode_frame(packet.kind, packet.payload)


ECHO0, ECHO1 = encode_frame(0), encode_frame(1)
NAMES = frame(encode_names("IIT-madras_3906", "Pioneer", "P3AT-SH"))
STRANGER = frame(encode_names("stranger", "Pioneer", "amigo"))
CONFIG = frame(ConfigPac(front_bumps=5, rear_bumps=5).encode())
FAST_CONFIG = frame(ConfigPac(front_bumps=5, rear_bumps=5, autobaud=2).encode())
RESET = encode_frame(0xFF)
BYTES = {
    Input.ECHO0: ECHO0,
    Input.ECHO1: ECHO1,
    Input.NAMES: NAMES,
    Input.STRANGER: STRANGER,
    Input.SIP: frame(Sip().encode()),
    Input.CONFIG: CONFIG,
    Input.RESET: RESET,
}


def sip(**fields: int) -> bytes:
    return frame(Sip(**fields).encode())


class Bench:
    """A session with a simulated peer, which records the bytes sent and the events."""

    def __init__(self, model: str = "auto", baudrate: int | None = None) -> None:
        self.session = Session(ROBOTS.get(model))
        self.now = 100.0
        self.baudrate = baudrate
        self.events: list[SessionEvent] = []
        self._decoder = Decoder()

    def connect(self) -> Self:
        self.session.connect(self.now, self.baudrate)
        return self

    def hear(self, data: bytes) -> None:
        self.events += self.session.receive(data, self.now)

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.events += self.session.tick(self.now)

    def sent(self) -> Sent:
        packets = self._decoder.feed(self.session.data_to_send(), self.now)
        return [(Command(p.kind), decode_argument(p.kind, p.payload) if p.payload else None) for p in packets]

    def commands(self) -> list[Command]:
        return [command for command, _ in self.sent()]

    def turns(self, times: int, data: bytes = b"", period_s: float = 0.05) -> Sent:
        """Receive ``data`` and tick in each period; return what was sent."""
        for _ in range(times):
            if data:
                self.hear(data)
            self.wait(period_s)
        return self.sent()

    def go_to(self, state: SessionState) -> Self:
        """Come into a state the way a robot would bring us there."""
        faster = state in {SessionState.ASKING_FASTER, SessionState.FASTER}
        answers = {
            SessionState.SYNC0: ECHO0,
            SessionState.SYNC1: ECHO1,
            SessionState.SYNC2: NAMES,
            SessionState.CONFIGURING: (FAST_CONFIG if faster else CONFIG) + sip(),
        }
        self.baudrate = 9600 if faster else self.baudrate
        if state is not SessionState.IDLE:
            self.connect()
        if state is SessionState.HANGING_UP:
            self.hear(sip())
        while self.session.state is not state:
            assert self.now < 110.0
            if self.session.state in answers:
                self.hear(answers.pop(self.session.state))
            else:
                self.wait(PATIENCE_S[self.session.state])
        self.sent()
        self.events.clear()
        return self

    def apply(self, what: Input) -> None:
        if what is Input.CONNECT:
            self.session.connect(self.now)
        elif what is Input.CLOSE:
            self.session.close(self.now)
        elif what is Input.LINK_DOWN:
            self.events += self.session.link_down("unplugged", self.now)
        elif what is Input.EXPIRED:
            patience = PATIENCE_S[self.session.state]
            self.wait(patience if patience < 10 else 10.0)
        else:
            self.hear(BYTES[what])
