"""A base that behaves as AMRISim, the simulator that Pioneer users have, where it differs from ARCOS.

What it says of itself, names and CONFIGpac, are the recorded bytes of a real AMRISim; the rest is what its
recorded sessions show and its source says (EmulatePioneer.cc; facts only).
"""

import threading
import time
from dataclasses import replace

from bridge.pioneer.arcos import Decoder
from bridge.pioneer.packets import SIP_KINDS, ConfigPac, Kind, Sip
from kit.arcos_captures import CAPTURES
from rover_ncp.core.process import ClosedAtExit
from rover_ncp.robot.description import load_description
from sim.pioneer.firmware import ClientState, Firmware
from sim.pioneer.server import Server
from sim.world.described import described_rover
from sim.world.pymunk_rover import Ground, PymunkRover

MODEL = "p3at-sh"
CAPTURE = next(capture for capture in CAPTURES if capture.name == "aria_simpleConnect_p3at-sh")
RECORDED = {
    packet.kind: packet
    for packet in Decoder().feed(b"".join(data for _, data in CAPTURE.chunks("r2c")), 0.0)
    if packet.kind in {Kind.SYNC2, Kind.CONFIG}
}


class AmriSim(Firmware):
    """Motors on from the start, SIPs always of type 0x32, counters of 16 bits, no watchdog, lenient SYNC."""

    def _open(self):
        super()._open()
        self.drive.enable(True)

    def _synchronise(self, packet):
        self._expected = packet.kind
        super()._synchronise(packet)

    def _substep(self):
        self._fed_s = self.now  # it only logs a warning
        super()._substep()

    def _emit(self, packet):
        packet = RECORDED.get(packet.kind, packet)
        if packet.kind in SIP_KINDS:
            x, y, _ = self.drive.odometry
            units = self.robot.arcos.distance_mm / 1000
            counters = {"x": round(x / units) % 65536, "y": round(y / units) % 65536}
            packet = replace(Sip.decode(packet), **counters, moving=False).encode()
        super()._emit(packet)


class AmriSimServer(ClosedAtExit):
    """One on TCP, turned by a thread until ``close``."""

    def __init__(self):
        self.rover = PymunkRover(described_rover(load_description(MODEL)), Ground())
        flash = ConfigPac.decode(RECORDED[Kind.CONFIG].payload)
        firmware = AmriSim(MODEL, self.rover, None, time.monotonic(), config=flash)
        self.server = Server("127.0.0.1", 0, firmware)
        self.base = f"tcp/127.0.0.1:{self.server.port}"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.server.serve, args=(self._stop.is_set,), daemon=True)
        self._thread.start()

    @property
    def connected(self):
        return self.server.firmware.client is ClientState.OPEN

    def close(self):
        self._stop.set()
        self._thread.join()
        self.server.close()
