"""The firmware of a Pioneer on a simulated rover: bytes in, bytes out, time passed in.

Rules of this file:

1. Time moves only in ``advance`` and ``receive``, in substeps of 0.01 s; what is received at a time acts
   after the substeps before it.
2. Waiting for a client, SYNC0, SYNC1 and SYNC2 are echoed in order; a repeated one is echoed again, one out
   of order starts over, all else is ignored. In a session the same numbers are PULSE, OPEN and CLOSE.
3. Any valid packet feeds the watchdog. When it has starved for 2 s the base halts; motors, session and
   setpoints stay, and the next packet of any kind makes the base follow its setpoints again.
4. Unknown commands and arguments that are cut short or of the wrong type are counted and ignored.
5. The session belongs to the base, not to the line: a client that vanishes leaves it open.

Sources: Adept Pioneer 3 manual p. 33, 37, 38, 43, 46, 50; AROS manual p. 28, 42 to 44. AMRISim differs in
many of these points.
"""

import math
from collections import Counter
from collections.abc import Callable
from enum import Enum

from bridge.pioneer.framing import HOSTBAUD_RATES, Command, Decoder, Packet, encode_frame
from bridge.pioneer.packets import ConfigPac, Kind, encode_names
from rover_ncp.core.geometry import Pose
from rover_ncp.robot.description import RobotDescription, load_description
from sim.base.client_commands import IGNORED, MockCommand, decode_argument, pair
from sim.base.faults import Faults
from sim.base.models import BASE_CLASS, BASE_NAME, config_of
from sim.base.report import BATTERY_DV, Panel, Reporter
from sim.base.sensors import Gyro, Sonars
from sim.base.simulated_base import SimulatedBase
from sim.base.trial import BaseTrial
from sim.world.rover import Rover

VEL2_M_S = 0.02
"""Wheel speed per unit of VEL2 (Vel2Divisor 20)."""

SETPOINTS = frozenset({Command.VEL, Command.RVEL})
"""Commands that do not arrive while a trial loses commands."""

BUMPED_SEGMENT = 2
"""The front bumper segment that the fault presses: the middle of five."""


class ClientState(Enum):
    """How far a client has come."""

    WAITING = "waiting for a client"
    SYNCED = "handshake done, not open"
    OPEN = "servers running"


class Firmware(SimulatedBase):
    """One Pioneer: ``model`` is a description or its name.

    ``config`` holds the FLASH values if they are not those of the model, ``gyro_seed`` is that of a gyro's
    noise. Faults and the trial count from when the motors were first enabled.
    """

    def __init__(
        self,
        model: str | RobotDescription,
        rover: Rover,
        faults: Faults | None = None,
        start_s: float = 0.0,
        *,
        config: ConfigPac | None = None,
        trial: BaseTrial | None = None,
        gyro_seed: int = 0,
    ) -> None:
        robot = load_description(model) if isinstance(model, str) else model
        super().__init__(robot, rover, faults, start_s, trial)
        self.decoder = Decoder()
        self.unknown: Counter[int] = Counter()
        """How often each unknown command came."""
        self.bad_arguments: Counter[int] = Counter()
        """How often each command came with an argument that could not be used."""
        self._config = config or config_of(self.robot)
        self._sonars = Sonars(self.robot, self._config.sonar_cycle / 1000)
        self._reporter = Reporter(self.robot, self._config, self.drive, self._sonars)
        self._gyro = Gyro(rover, start_s, gyro_seed)
        self._home = rover.pose
        self.baudrate = HOSTBAUD_RATES[0]
        """The rate of its serial line: HOSTBAUD changes it, the end of a session restores FLASH's."""
        self.client = ClientState.WAITING
        self._due_s = self._measure_due_s = math.inf
        """When the next SIP will be sent, and when its content will be measured."""
        self._expected = 0
        self._out = bytearray()
        self._handlers = self._make_handlers()
        self._power_up()

    # Calls of the line.

    @property
    def ignored(self) -> int:
        """Number of commands that are not known, or whose arguments could not be used."""
        return self.unknown.total() + self.bad_arguments.total()

    @property
    def due_s(self) -> float:
        """When it sends the next SIP, infinite without a session."""
        return self._due_s

    def receive(self, data: bytes, now: float) -> None:
        """Take over bytes from the client, those of ``now``."""
        self.advance(now)
        if self._fault("deaf") is not None:
            return
        self._decode(self._faults.damage(data, self._driven_s), now)

    def data_to_send(self) -> bytes:
        """Return the bytes for the client and forget them."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def line_changed(self) -> None:
        """Drop half-received and unsent bytes: they belong to the last client."""
        self.decoder.drop()
        self._out.clear()

    # Time.

    def _substep(self) -> None:
        self._apply_faults()
        starved = self.now - self._fed_s >= self._config.watchdog / 1000 - 1e-9
        self.drive.substep(halted=starved or self.panel.blocked)
        self._substeps += 1
        self._decode(b"", self.now)
        self._sonars.fire(self.drive.rover, self.now)
        if self.observe:
            self.observe(self.now)
        if self.client is ClientState.OPEN and self.now >= self._measure_due_s - 1e-9:
            self._measure_due_s += self._config.sip_cycle / 1000
            self._reporter.measure()
        if self.client is ClientState.OPEN and self.now >= self._due_s - 1e-9:
            self._report()
            self._due_s = self._measure_due_s + self._trial.next_age_s

    def _report(self) -> None:
        if self._first_s is not None:
            self._begin_tick(self._trial.tick + 1)
            self._reporter.noise = self._trial.noise
        sip = self._reporter.sip()
        if self._streaming(MockCommand.SIM_STAT):
            self._emit(self._reporter.simstat())
        if self._gyro.on:
            self._emit(self._gyro.packet(self.now))
        self._emit(sip)
        if self._streaming(MockCommand.IOREQUEST):
            self._emit(self._reporter.io())
        if self._streaming(MockCommand.ENCODER):
            self._emit(self._reporter.encoders())

    def _streaming(self, command: int) -> bool:
        """Return whether a packet is due: mode 1 asks for one, more for a stream."""
        mode = self._streams.get(command, 0)
        if mode == 1:
            del self._streams[command]
        return mode > 0

    def _emit(self, packet: Packet) -> None:
        if self._fault("mute") is None:
            frame = encode_frame(packet.kind, packet.payload)
            self._out += self._faults.damage(frame, self._driven_s)

    def _switch_gyro(self, mode: int) -> None:
        self._gyro.on = mode > 0 and self._config.has_gyro == 1

    # Faults.

    def _apply_faults(self) -> None:
        """Apply the faults that are active now."""
        panel, reporter = self.panel, self._reporter
        pressed = self._fault("stop-button") is not None
        if pressed and not panel.stop_pressed and panel.e_stall:
            self.drive.enable(False)
        panel.stop_pressed = pressed
        panel.front_bumpers = 0 if self._fault("bumper") is None else 1 << BUMPED_SEGMENT
        panel.blocked = self._fault("stall") is not None
        low = self._fault("low-battery")
        panel.battery_dv = self._battery_test_dv or (BATTERY_DV if low is None else round(low * 10))
        reporter.odometry_frozen = self._fault("freeze-odometry") is not None
        reporter.odometry_jump_m = self._fault("jump-odometry") or 0.0
        self._gyro.error_rad_s = self._fault("gyro") or 0.0
        if self._reset_begins():
            self._restart()

    # Packets.

    def _decode(self, data: bytes, now: float) -> None:
        for packet in self.decoder.feed(data, now):
            self._take(packet)

    def _take(self, packet: Packet) -> None:
        self._fed_s = self.now
        if self.client is ClientState.WAITING:
            self._synchronise(packet)
            return
        command = packet.kind
        if command in SETPOINTS and self._trial.lost:
            return
        argument = decode_argument(command, packet.payload)
        if command in self._handlers:
            if isinstance(argument, int):
                self._handlers[command](argument)
            else:
                self.bad_arguments[command] += 1
        elif command == MockCommand.POLLING and isinstance(argument, bytes):
            self._sonars.poll(argument)
        elif command == MockCommand.SIM_SET_POSE and isinstance(argument, tuple):
            x, y, theta = argument
            self.drive.place(Pose(x / 1000, y / 1000, math.radians(theta)))
        elif command in {MockCommand.POLLING, MockCommand.SIM_SET_POSE}:
            self.bad_arguments[command] += 1
        elif command not in IGNORED:
            self.unknown[command] += 1

    def _synchronise(self, packet: Packet) -> None:
        if packet.kind > Kind.SYNC2 or packet.kind > self._expected:
            self._expected = 0
            return
        self._expected = packet.kind + 1
        if packet.kind == Kind.SYNC2:
            self.client = ClientState.SYNCED
            self._emit(encode_names(BASE_NAME, BASE_CLASS, self.robot.name))
        else:
            self._emit(packet)

    def _make_handlers(self) -> dict[int, Callable[[int], None]]:
        """Return what each command does with its number, 0 for one without."""
        drive, radians = self.drive, math.radians
        return {
            Command.PULSE: lambda _: None,
            Command.OPEN: lambda _: self._open(),
            Command.CLOSE: lambda _: self._wait(),
            Command.CONFIG: lambda _: self._emit(self._reporter.config()),
            MockCommand.RESET: lambda _: self._restart(),
            Command.ENABLE: self._enable,
            Command.VEL: lambda mm_s: drive.set_speed(mm_s / 1000),
            Command.RVEL: lambda deg_s: drive.set_turn(radians(deg_s)),
            MockCommand.ROTATE: lambda deg_s: drive.set_turn(radians(deg_s)),
            MockCommand.VEL2: self._set_wheels,
            MockCommand.MOVE: lambda mm: drive.move(mm / 1000),
            MockCommand.HEAD: lambda deg: drive.turn_to(radians(deg)),
            MockCommand.DHEAD: lambda deg: drive.turn_to(drive.odometry.theta + radians(deg)),
            MockCommand.DCHEAD: lambda deg: drive.turn_to(drive.heading_setpoint + radians(deg)),
            Command.STOP: lambda _: drive.stop(),
            Command.E_STOP: lambda _: drive.emergency_stop(),
            MockCommand.QSTOP: lambda _: drive.emergency_stop(),
            Command.SETV: self._set_v_limit,
            Command.SETRV: self._set_omega_limit,
            Command.SETA: self._set_acceleration,
            Command.SETRA: self._set_turn_acceleration,
            Command.SETO: lambda _: drive.zero_odometry(),
            Command.SONAR: self._sonars.switch,
            MockCommand.SONARCYCLE: self._sonars.set_cycle,
            MockCommand.ENCODER: lambda mode: self._streams.update({MockCommand.ENCODER: mode}),
            Command.GYRO: self._switch_gyro,
            MockCommand.IOREQUEST: lambda mode: self._streams.update({MockCommand.IOREQUEST: mode}),
            MockCommand.SIM_STAT: lambda mode: self._streams.update({MockCommand.SIM_STAT: mode}),
            MockCommand.DIGOUT: self.panel.set_outputs,
            MockCommand.ADSEL: self.panel.select_port,
            MockCommand.E_STALL: self.panel.set_e_stall,
            MockCommand.BATTEST: self._test_battery,
            MockCommand.SIM_RESET: lambda _: self._go_home(),
            Command.HOSTBAUD: self._set_baudrate,
        }

    # Commands.

    @property
    def panel(self) -> Panel:
        """Battery, buttons, bumpers, ports."""
        return self._reporter.panel

    def _power_up(self) -> None:
        self.drive.zero_odometry()
        self._fed_s = self.now
        self._battery_test_dv = 0
        self._wait()

    def _wait(self) -> None:
        """End the session: stop, motors off, working values as in FLASH (AROS manual p. 44)."""
        self.client = ClientState.WAITING
        self._expected = 0
        self._due_s = self._measure_due_s = math.inf
        self._streams: dict[int, int] = {}
        self._gyro.on = False
        self.baudrate = HOSTBAUD_RATES[self._config.host_baud]
        self.drive.enable(False)
        self.drive.restore_flash()
        self._sonars.restore_flash()

    def _open(self) -> None:
        if self.client is ClientState.SYNCED:
            self.client = ClientState.OPEN
            self._measure_due_s = self.now + self._config.sip_cycle / 1000
            self._due_s = self._measure_due_s + self._trial.next_age_s

    def _restart(self) -> None:
        self._emit(Packet(Kind.RESET_FF))
        self._power_up()

    def _go_home(self) -> None:
        self.drive.place(self._home)
        self.drive.zero_odometry()

    def _enable(self, on: int) -> None:
        if on and self.panel.stop_pressed and self.panel.e_stall:
            return
        if bool(on) != self.drive.enabled:
            self.drive.enable(bool(on))
        if on and self._first_s is None:
            self._first_s = self.now

    def _set_wheels(self, word: int) -> None:
        left, right = (units * VEL2_M_S for units in pair(word))
        self.drive.set_speed((left + right) / 2)
        self.drive.set_turn((right - left) / 2 / self.robot.half_track_m)

    def _set_v_limit(self, mm_s: int) -> None:
        self.drive.v_limit = min(mm_s, self._config.trans_vel_top) / 1000

    def _set_omega_limit(self, deg_s: int) -> None:
        self.drive.omega_limit = math.radians(min(deg_s, self._config.rot_vel_top))

    def _set_acceleration(self, mm_s2: int) -> None:
        name = "accel" if mm_s2 > 0 else "decel"
        if mm_s2:
            self.drive.set_limit(**{name: min(abs(mm_s2), self._config.trans_acc_top) / 1000})

    def _set_turn_acceleration(self, deg_s2: int) -> None:
        name = "alpha" if deg_s2 > 0 else "alpha_decel"
        if deg_s2:
            self.drive.set_limit(**{name: math.radians(min(abs(deg_s2), self._config.rot_acc_top))})

    def _set_baudrate(self, code: int) -> None:
        if code < len(HOSTBAUD_RATES):
            self.baudrate = HOSTBAUD_RATES[code]

    def _test_battery(self, decivolts: int) -> None:
        self._battery_test_dv = decivolts
