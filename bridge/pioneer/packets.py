"""Packets of a base that the bridge reads: SIP, CONFIGpac, GYROpac, both ways, in the base's own units.

Each packet is a dataclass whose fields stand in the order of the wire, each with its wire format: one table
serves decoding and encoding. Firmware versions end their packets at different fields: a field that did not
arrive keeps its default, and encoding ends at the first None.

Formats: B, b, H, h, I, 17s as in ``struct`` (little-endian), S a string that a NUL ends.
Sources: ARIA's ArRobot::processMotorPacket, ArRobotConfigPacketReader, AMRISim's EmulatePioneer (order of
fields; facts only), Adept Pioneer 3 manual p. 43 (FLAGS); ARIA's ArAnalogGyro (GYROpac).
"""

import math
import struct
from dataclasses import dataclass, field, fields
from enum import IntEnum, IntFlag
from typing import Any, Self, TypeAlias

from bridge.pioneer.framing import Packet


class Kind(IntEnum):
    """Packet types of a base."""

    SYNC0 = 0x00
    SYNC1 = 0x01
    SYNC2 = 0x02
    CONFIG = 0x20
    SIP_STOPPED = 0x32
    SIP_MOVING = 0x33
    GYRO = 0x98
    RESET_FE = 0xFE
    RESET_FF = 0xFF


SIP_KINDS = range(0x30, 0x35)
"""Player's p2os accepts all of these as SIPs; ARCOS sends 0x32 and 0x33."""

NO_ECHO_MM = 5000
"""Range of a sonar without an echo (AMRISim)."""


class Flag(IntFlag):
    """Bits of a SIP's FLAGS (manual p. 43, table 8). The manual names both STOP bits for the button."""

    MOTORS = 1 << 0
    SONAR_1 = 1 << 1
    SONAR_2 = 1 << 2
    STOP_BUTTON = 1 << 5
    E_STALL = 1 << 6


def _wire(format_: str, default: Any = None) -> Any:
    """Declare a field of a packet with its wire format."""
    return field(default=default, metadata={"wire": format_})


Formats: TypeAlias = list[tuple[str, str]]
"""Names and wire formats of fields."""


def _wire_formats(packet: Any) -> Formats:
    return [(item.name, item.metadata["wire"]) for item in fields(packet) if "wire" in item.metadata]


def _read(formats: Formats, data: bytes, start: int = 0) -> tuple[dict[str, Any], int]:
    """Return the fields that ``data`` holds whole, and where reading ended."""
    values: dict[str, Any] = {}
    for name, format_ in formats:
        if format_ == "S":
            if start >= len(data):
                break
            end = data.find(0, start)
            end = len(data) if end < 0 else end
            values[name] = data[start:end].decode("latin-1")
            start = end + 1
            continue
        size = struct.calcsize("<" + format_)
        if start + size > len(data):
            break
        values[name] = struct.unpack_from("<" + format_, data, start)[0]
        start += size
    return values, start


def _write(formats: Formats, packet: Any) -> bytes:
    data = b""
    for name, format_ in formats:
        value = getattr(packet, name)
        if value is None:
            break
        if format_ == "S":
            data += value.encode("latin-1") + b"\0"
        else:
            data += struct.pack("<" + format_, value)
    return data


@dataclass(frozen=True)
class Sip:
    """Server information packet (SIP): the base report of each cycle (ARCOS section "SIP").

    x and y are counters of 15 bits (AMRISim's have 16) in the model's distance unit, theta has 4096 units a
    turn. ``sonar`` holds (number, range) of the sonars read since the last SIP.
    """

    x: int = _wire("H", 0)
    y: int = _wire("H", 0)
    theta: int = _wire("h", 0)
    left: int = _wire("h", 0)
    right: int = _wire("h", 0)
    battery_dv: int = _wire("B", 0)
    stall_left: int = _wire("B", 0)  # bit 0 stalled, bits 1 to 7 rear bumpers
    stall_right: int = _wire("B", 0)  # bit 0 stalled, bits 1 to 7 front bumpers
    control: int = _wire("h", 0)  # heading setpoint
    flags: int = _wire("H", 0)
    compass: int | None = _wire("B")
    # The sonar readings stand here on the wire: a count, then number and range of each.
    grip_state: int | None = _wire("B")
    analog_port: int | None = _wire("B")
    analog: int | None = _wire("B")
    digin: int | None = _wire("B")
    digout: int | None = _wire("B")  # P2OS and AROS end here
    battery_x10: int | None = _wire("H")  # decivolts, for systems above 25.5 V
    charge_state: int | None = _wire("B")
    rotvel: int | None = _wire("h")  # 0.1 deg/s
    faults: int | None = _wire("H")
    latvel: int | None = _wire("h")
    temperature: int | None = _wire("b")
    state_of_charge: int | None = _wire("B")
    uptime_us: int | None = _wire("I")
    flags3: int | None = _wire("I")
    sonar: tuple[tuple[int, int], ...] = ()
    moving: bool = False

    @classmethod
    def decode(cls, packet: Packet) -> "Sip | None":
        """Return the SIP of a packet whose kind is one of SIP_KINDS; None when it ends before FLAGS."""
        payload = packet.payload
        head, end = _read(_SIP_HEAD, payload)
        if "flags" not in head:
            return None
        sonar: list[tuple[int, int]] = []
        tail: dict[str, Any] = {}
        if end < len(payload):
            count, end = payload[end], end + 1
            # A count beyond the packet (AMRISim, when its sonars were just switched on) announces readings
            # that are not there: what follows is neither readings nor the tail at its place.
            if end + 3 * count <= len(payload):
                sonar = [struct.unpack_from("<BH", payload, end + 3 * i) for i in range(count)]
                tail, _ = _read(_SIP_TAIL, payload, end + 3 * count)
        return cls(**head, **tail, sonar=tuple(sonar), moving=packet.kind == Kind.SIP_MOVING)

    def encode(self) -> Packet:
        """Return the packet; it ends at the first group that is None."""
        payload = _write(_SIP_HEAD, self)
        if self.compass is not None:
            payload += bytes([len(self.sonar)])
            payload += b"".join(struct.pack("<BH", number, range_mm) for number, range_mm in self.sonar)
            payload += _write(_SIP_TAIL, self)
        return Packet(Kind.SIP_MOVING if self.moving else Kind.SIP_STOPPED, payload)


_SIP_FIELDS = _wire_formats(Sip)
_SIP_SPLIT = [name for name, _ in _SIP_FIELDS].index("compass") + 1
_SIP_HEAD, _SIP_TAIL = _SIP_FIELDS[:_SIP_SPLIT], _SIP_FIELDS[_SIP_SPLIT:]


@dataclass(frozen=True)
class ConfigPac:
    """The base's configuration, FLASH and working values. Speeds mm/s and deg/s, times ms, decivolts."""

    robot_type: str = _wire("S", "")
    subtype: str = _wire("S", "")
    serial_number: str = _wire("S", "")
    four_motors: int = _wire("B", 0)
    rot_vel_top: int = _wire("H", 0)
    trans_vel_top: int = _wire("H", 0)
    rot_acc_top: int = _wire("H", 0)
    trans_acc_top: int = _wire("H", 0)
    pwm_max: int = _wire("H", 0)
    name: str = _wire("S", "")
    sip_cycle: int = _wire("B", 0)
    host_baud: int = _wire("B", 0)
    aux1_baud: int = _wire("B", 0)
    gripper: int = _wire("H", 0)
    front_sonar: int = _wire("H", 0)
    rear_sonar: int = _wire("B", 0)
    low_battery: int = _wire("H", 0)
    rev_count: int = _wire("H", 0)
    watchdog: int = _wire("H", 0)
    p2_mpacs: int = _wire("B", 0)
    stall_val: int = _wire("H", 0)
    stall_count: int = _wire("H", 0)
    joy_vel: int = _wire("H", 0)
    joy_rot_vel: int = _wire("H", 0)
    rot_vel_max: int = _wire("H", 0)
    trans_vel_max: int = _wire("H", 0)
    rot_acc: int = _wire("H", 0)
    rot_decel: int = _wire("H", 0)
    rot_kp: int = _wire("H", 0)
    rot_kv: int = _wire("H", 0)
    rot_ki: int = _wire("H", 0)
    trans_acc: int = _wire("H", 0)
    trans_decel: int = _wire("H", 0)
    trans_kp: int = _wire("H", 0)
    trans_kv: int = _wire("H", 0)
    trans_ki: int = _wire("H", 0)
    front_bumps: int = _wire("B", 0)
    rear_bumps: int = _wire("B", 0)
    charger: int = _wire("B", 0)
    sonar_cycle: int = _wire("B", 0)
    autobaud: int = _wire("B", 0)
    has_gyro: int = _wire("B", 0)
    drift_factor: int = _wire("h", 0)
    aux2_baud: int = _wire("B", 0)
    aux3_baud: int = _wire("B", 0)
    ticks_mm: int = _wire("H", 0)
    shutdown_volts: int = _wire("H", 0)
    version: str = _wire("S", "")
    gyro_to_charge: bytes = _wire("17s", bytes(17))  # 9 fields; AMRISim ends here
    power_to_gyro: bytes = _wire("18s", bytes(18))  # 10 fields

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Return the packet; what is missing at its end keeps its default."""
        return cls(**_read(_wire_formats(cls), payload)[0])

    @property
    def sends_gyro(self) -> bool:
        """Whether the base sends its gyro's readings when asked; with 2 its headings have them already."""
        return self.has_gyro == 1

    def encode(self) -> Packet:
        """Return the packet, ready for ``encode_frame``."""
        return Packet(Kind.CONFIG, _write(_wire_formats(type(self)), self))


GYRO_REST = 512
"""About what a gyro at rest reads, of 0..1023."""
GYRO_RAD_S = math.radians(5 / 1023 * 300 / 2.5 * 1.626)
"""Rate of turn per unit: 5 V over 1023 units, 300 deg/s at 2.5 V, and the GyroScaler of all Pioneers."""


@dataclass(frozen=True)
class GyroPac:
    """A gyro's readings since the last cycle, each with its temperature. Below rest is to the left."""

    readings: tuple[tuple[int, int], ...] = ()

    @classmethod
    def decode(cls, payload: bytes) -> "GyroPac":
        """Read as many of the readings it promises as it holds."""
        count = min(payload[0], (len(payload) - 1) // 3) if payload else 0
        return cls(tuple(struct.iter_unpack("<HB", payload[1 : 1 + 3 * count])))

    def encode(self) -> Packet:
        """Return the packet."""
        payload = b"".join(struct.pack("<HB", *reading) for reading in self.readings)
        return Packet(Kind.GYRO, bytes([len(self.readings)]) + payload)

    @property
    def rate(self) -> float | None:
        """Mean turn rate in rad/s, counter-clockwise; None without readings.

        It has a constant offset, because the reading at rest is not exactly `GYRO_REST`.
        """
        if not self.readings:
            return None
        mean = sum(reading for reading, _ in self.readings) / len(self.readings)
        return (GYRO_REST - mean) * GYRO_RAD_S


def decode_names(payload: bytes) -> tuple[str, str, str]:
    """Return name, class and subtype from a SYNC2 echo; a string that is missing is empty."""
    parts = [part.decode("latin-1") for part in payload.split(b"\0")]
    name, robot_class, subtype = [*parts, "", "", ""][:3]
    return name, robot_class, subtype


def encode_names(name: str, robot_class: str, subtype: str) -> Packet:
    """Return the SYNC2 echo of a base with these names."""
    return Packet(Kind.SYNC2, "".join(s + "\0" for s in (name, robot_class, subtype)).encode("latin-1"))
