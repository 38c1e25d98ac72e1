"""Report packets of the base: SIP, CONFIGpac, ENCODERpac, IOpac, SIMSTAT.

Sources of what the bridge does not read: Adept Pioneer 3 manual p. 46 (ENCODERpac), p. 50 (IOpac); AMRISim's
SIMSTAT, whose recorded packets have this layout.
"""

import math
import struct
from dataclasses import dataclass, replace

from bridge.pioneer.framing import Packet
from bridge.pioneer.odometry import COUNTER_BITS, HEADING_BITS, WHEEL_SPEED_M_S, counter_difference
from bridge.pioneer.packets import ConfigPac, Flag, Sip
from rover_ncp.core.geometry import ORIGIN
from rover_ncp.robot.description import RobotDescription
from sim.base.drive_train import DriveTrain
from sim.base.models import TICKS_PER_MM
from sim.base.sensors import Sonars

SIMSTAT, ENCODER, IO = 0x62, 0x90, 0xF0
"""Packet types that the bridge does not read."""

BATTERY_DV = 128

IDLE_LEVEL = 0xFF
"""Digital lines are pulled up: 1 is idle, 0 is triggered (manual p. 50)."""

UNDER_VOLTAGE = 1 << 3
"""Bit of FAULTFLAGS (ARIA's demo)."""

NO_TEMPERATURE = -128


@dataclass
class Panel:
    """Battery, buttons, bumpers, ports: what is neither drive nor sonar."""

    battery_dv: int = BATTERY_DV
    stop_pressed: bool = False
    e_stall: bool = True
    """Whether the STOP button switches the motors off."""
    front_bumpers: int = 0
    """Bit 0 is the left-most segment."""
    blocked: bool = False
    """Both motors stall, even if the wheels turn."""
    analog_port: int = 0
    digout: int = 0

    def set_outputs(self, word: int) -> None:
        """DIGOUT: high byte the outputs to change, low byte their states."""
        mask = word >> 8 & 0xFF
        self.digout = (self.digout & ~mask) | (word & mask)

    def select_port(self, number: int) -> None:
        """ADSEL."""
        self.analog_port = number & 0xFF

    def set_e_stall(self, on: int) -> None:
        """E_STALL."""
        self.e_stall = bool(on)


class Reporter:
    """Writes the packets of one base."""

    def __init__(self, robot: RobotDescription, config: ConfigPac, drive: DriveTrain, sonars: Sonars) -> None:
        self.panel = Panel()
        self.odometry_frozen = False
        self.odometry_jump_m = 0.0
        self.noise = ORIGIN
        """Added to the pose."""
        assert robot.arcos is not None
        self._distance_m = robot.arcos.distance_mm / 1000
        self._config = config
        self._drive = drive
        self._sonars = sonars
        self.measure()

    def measure(self) -> None:
        """Store the motion that the next packets report."""
        if self.odometry_frozen:
            return
        drive = self._drive
        left, right = (round(speed / WHEEL_SPEED_M_S) for speed in drive.wheel_speeds)
        self._odometry, self._wheels_m = drive.odometry, drive.wheels_m
        self._motion = Sip(
            left=left,
            right=right,
            control=_heading(drive.heading_setpoint),
            rotvel=round(math.degrees(drive.measured.omega) * 10),
            moving=drive.rover.moving,
        )

    def sip(self) -> Packet:
        """Return the SIP of the motion last measured; sonar readings are those since the last SIP."""
        panel, pose, noise = self.panel, self._odometry, self.noise
        distance_m = self._distance_m
        stalled = (True, True) if panel.blocked else self._drive.stalled
        return replace(
            self._motion,
            x=_counter((pose.x + noise.x + self.odometry_jump_m) / distance_m),
            y=_counter((pose.y + noise.y) / distance_m),
            theta=_heading(pose.theta + noise.theta),
            battery_dv=min(panel.battery_dv, 255),
            stall_left=int(stalled[0]),
            stall_right=int(stalled[1]) | panel.front_bumpers << 1,
            flags=self._flags(),
            compass=0,
            grip_state=0,
            analog_port=panel.analog_port,
            analog=0,
            digin=IDLE_LEVEL,
            digout=panel.digout,
            battery_x10=panel.battery_dv,
            charge_state=0,
            faults=UNDER_VOLTAGE if panel.battery_dv < self._config.low_battery else 0,
            latvel=0,
            temperature=NO_TEMPERATURE,
            state_of_charge=0,
            sonar=self._sonars.take(),
        ).encode()

    def _flags(self) -> int:
        flags = self._sonars.flags
        if self._drive.enabled:
            flags |= Flag.MOTORS
        if self.panel.stop_pressed:
            flags |= Flag.STOP_BUTTON
            if self.panel.e_stall:
                flags |= Flag.E_STALL
        return flags

    def config(self) -> Packet:
        """Return the CONFIGpac: FLASH, and the limits now in force."""
        drive = self._drive
        return replace(
            self._config,
            trans_vel_max=round(drive.v_limit * 1000),
            rot_vel_max=round(math.degrees(drive.omega_limit)),
            trans_acc=round(drive.limits["accel"] * 1000),
            trans_decel=round(drive.limits["decel"] * 1000),
            rot_acc=round(math.degrees(drive.limits["alpha"])),
            rot_decel=round(math.degrees(drive.limits["alpha_decel"])),
        ).encode()

    def encoders(self) -> Packet:
        """Return the ENCODERpac: ticks since power-up, which wrap at 32 bits."""
        ticks = (round(way * 1000 * TICKS_PER_MM) for way in self._wheels_m)
        return Packet(ENCODER, struct.pack("<2i", *(counter_difference(count, 0, 32) for count in ticks)))

    def io(self) -> Packet:
        """Return the IOpac; its last analog value is the battery, 0 to 1023 for 0 to 25.5 V (chosen)."""
        bumpers = IDLE_LEVEL & ~self.panel.front_bumpers
        battery = min(round(self.panel.battery_dv / 255 * 1023), 1023)
        inputs = (IDLE_LEVEL, bumpers, IDLE_LEVEL, IDLE_LEVEL)
        counts_and_bytes = bytes([len(inputs), *inputs, 1, self.panel.digout, 9])
        return Packet(IO, counts_and_bytes + struct.pack("<9H", *[0] * 8, battery))

    def simstat(self) -> Packet:
        """Return the SIMSTAT: the true pose."""
        x, y, theta = self._drive.rover.pose
        x_mm, y_mm = (counter_difference(round(place * 1000), 0, 32) for place in (x, y))
        # Flags, three intervals; x, y, z in mm, heading in deg; GPS position and errors of odometry.
        return Packet(
            SIMSTAT,
            struct.pack(
                "<HI3H4i7i",
                *(0, 0, *[self._config.sip_cycle] * 3),
                *(x_mm, y_mm, 0, round(math.degrees(theta)), *[0] * 7),
            ),
        )


def _counter(units: float) -> int:
    """Return a position as ARCOS sends it: 15 bits that wrap."""
    return round(units) % (1 << COUNTER_BITS)


def _heading(theta: float) -> int:
    """Return a heading in units of 4096 a turn, −2048 to 2047."""
    return counter_difference(round(theta / math.tau * (1 << HEADING_BITS)), 0, HEADING_BITS)
