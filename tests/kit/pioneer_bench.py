"""A mock Pioneer on a virtual clock, and a client for it."""

import math

from bridge.pioneer.framing import Command, Decoder, Packet, encode_command, encode_frame
from bridge.pioneer.packets import SIP_KINDS, Sip
from rover_ncp.course.course import Obstacle
from rover_ncp.robot.description import load_description
from sim.base.client_commands import STRING
from sim.base.firmware import ClientState, Firmware
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

Argument = int | bytes | None


class Pioneer:
    """``tell`` sends a command now, ``run`` lets time pass; what the base sent is in ``packets``."""

    def __init__(self, model: str = "p3at-sh", *, wall_x: float | None = None) -> None:
        walls = [Obstacle(x=wall_x, y=0.0, length=0.2, width=4.0)] if wall_x is not None else []
        self.rover = PymunkRover(described_rover(load_description(model)), Ground(walls))
        self.firmware = Firmware(model, self.rover)
        self.now = 0.0
        self.packets: list[Packet] = []
        self._decoder = Decoder()

    def _collect(self) -> list[Packet]:
        packets = self._decoder.feed(self.firmware.data_to_send(), self.now)
        self.packets += packets
        return packets

    def say(self, data: bytes) -> list[Packet]:
        """Send bytes and return the immediate answer."""
        self._collect()
        self.firmware.receive(data, self.now)
        return self._collect()

    def tell(self, command: int, argument: Argument = None) -> list[Packet]:
        if isinstance(argument, bytes):
            return self.say(encode_frame(command, bytes([STRING, len(argument)]) + argument))
        return self.say(encode_command(command, argument))

    def run(self, seconds: float, fed: bool = True) -> None:
        """Let time pass, with a PULSE each half second if ``fed``."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = min(self.now + 0.5, end)
            self.firmware.advance(self.now)
            self._collect()
            if fed:
                self.tell(Command.PULSE)

    def obey(self, seconds: float, command: int, argument: Argument = None) -> None:
        """Have the base receive a command and obey it for so long."""
        self.tell(command, argument)
        self.run(seconds)

    def drive(self, v_mm_s: int, seconds: float, fed: bool = True) -> None:
        self.tell(Command.VEL, v_mm_s)
        self.run(seconds, fed)

    def open(self) -> "Pioneer":
        for sync in (Command.PULSE, Command.OPEN, Command.CLOSE, Command.OPEN):
            self.tell(sync)
        assert self.firmware.client is ClientState.OPEN
        self.tell(Command.ENABLE, 1)
        return self

    def sips(self) -> list[Sip]:
        decoded = [Sip.decode(packet) for packet in self.packets if packet.kind in SIP_KINDS]
        return [sip for sip in decoded if sip is not None]

    def sip(self) -> Sip:
        """Return the next SIP."""
        self.packets.clear()
        while not self.sips():
            self.run(0.1)
        return self.sips()[-1]

    @property
    def speed(self) -> float:
        return self.rover.velocity.v

    @property
    def turn_deg_s(self) -> float:
        return math.degrees(self.rover.velocity.omega)
