"""A base that behaves as AMRISim, the simulator that Pioneer users have, where it differs from ARCOS.

What it says of itself, names and CONFIGpac, are the recorded bytes of a real AMRISim; the rest is what its
recorded sessions show and its source says (EmulatePioneer.cc; facts only).
"""

from dataclasses import replace

from bridge.pioneer.framing import Decoder
from bridge.pioneer.packets import SIP_KINDS, ConfigPac, Kind, Sip
from kit.arcos_captures import CAPTURES
from sim.pioneer.firmware import Firmware

MODEL = "p3at-sh"
CAPTURE = next(capture for capture in CAPTURES if capture.name == "aria_simpleConnect_p3at-sh")
RECORDED = {
    packet.kind: packet
    for packet in Decoder().feed(b"".join(data for _, data in CAPTURE.chunks("r2c")), 0.0)
    if packet.kind in {Kind.SYNC2, Kind.CONFIG}
}


class AmriSim(Firmware):
    """Motors on from the start, SIPs always of type 0x32, counters of 16 bits, no watchdog, lenient SYNC."""

    def __init__(self, robot, rover):
        super().__init__(robot, rover, config=ConfigPac.decode(RECORDED[Kind.CONFIG].payload))

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
