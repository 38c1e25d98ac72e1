"""A person drives: keys in, commands out, through the same lease and gate as a circuit's.

Rules of this file:

1. At every end, the lease is released first, then the terminal's settings are restored.
2. Commands are sent all the time, zero when no key is held. If this process hangs, the commands stop, and the
   gate stops the rover.
3. After a delay, the loop discards the keys that arrived meanwhile and commands zero.
"""

import contextlib
import os
import select
import sys
import termios
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Self

from pydantic import Field

from deploy.drive.link import Inbox, Link, RosCommand
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.zenoh_link import ZenohLink
from deploy.keyboard import HELP, Keyboard
from deploy.recorder import Recorder, RecordingResult
from deploy.topic_teleop import TopicTeleop
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output, printable
from rover_ncp.core.errors import INTERRUPTED, SafetyStop, UsageError
from rover_ncp.core.geometry import STANDSTILL
from rover_ncp.core.process import Clock, Interrupts
from rover_ncp.course.course import TICK_S
from rover_ncp.robot.dead_zone import DeadZone
from rover_ncp.robot.description import RobotDescription
from rover_ncp.wire.protocol import in_words

PERIOD_S = 0.05
LONGEST_LOOP_S = 0.25
TELEOP_FILE = "teleop.yaml"
READ_BYTES = 1024
_INPUT, _LOCAL, _CHARACTERS = 0, 3, 6


class TeleopResult(RecordingResult):
    """Result of a person's drive."""

    seconds: float = Field(description="of driving")
    stopped_by: str | None = Field(description="the safety rule")
    exit_code: int = Field(description="of the command")


class Terminal:
    """Standard input as a keyboard, inside a ``with`` block. Raises UsageError when it is no terminal.

    Ctrl-C stays a signal. Ctrl-Z and Ctrl-S are keys, because they would stop the driver or its screen.
    """

    def __init__(self) -> None:
        self._fd = sys.stdin.fileno() if sys.stdin is not None else -1
        if self._fd < 0 or not os.isatty(self._fd):
            raise UsageError("teleop reads keys: expected a terminal as standard input")

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self._fd)
        settings = termios.tcgetattr(self._fd)
        settings[_INPUT] &= ~(termios.IXON | termios.IXOFF)
        settings[_LOCAL] &= ~(termios.ICANON | termios.ECHO)
        # Neither may wait: `read` does, with a limit.
        settings[_CHARACTERS][termios.VMIN] = settings[_CHARACTERS][termios.VTIME] = 0
        settings[_CHARACTERS][termios.VSUSP] = os.fpathconf(self._fd, "PC_VDISABLE").to_bytes()
        # TCSAFLUSH would wait for the output of a stopped terminal.
        self.discard()
        termios.tcsetattr(self._fd, termios.TCSANOW, settings)
        return self

    def __exit__(self, *_: object) -> None:
        # A closed terminal cannot be restored.
        with contextlib.suppress(termios.error):
            termios.tcflush(self._fd, termios.TCIFLUSH)
            termios.tcsetattr(self._fd, termios.TCSANOW, self._before)

    def read(self, timeout_s: float) -> str | None:
        """Return the keys that came; wait for the first at most so long. None once the terminal is gone."""
        ready, _, _ = select.select([self._fd], [], [], timeout_s)
        if not ready:
            return ""
        try:
            data = os.read(self._fd, READ_BYTES)
        except OSError:
            return None
        return data.decode(errors="replace") if data else None

    def discard(self) -> None:
        """Discard unread keys."""
        termios.tcflush(self._fd, termios.TCIFLUSH)


class Teleop:
    """One person's drive over an open link; ``seconds`` is its duration.

    Commands within the dead band of ``robot`` become pulses, as those of a policy do.
    ``begin`` is called when the lease is granted.
    """

    def __init__(
        self,
        link: Link,
        terminal: Terminal,
        interrupted: Callable[[], bool],
        clock: Clock = time,
        *,
        begin: Callable[[], None] = lambda: None,
        robot: RobotDescription | None = None,
    ) -> None:
        self._begin = begin
        self._dead_zone = DeadZone(described=robot)
        self._link, self._terminal, self._clock = link, terminal, clock
        self._measurements = Measurements(link)
        self._monitor = SafetyMonitor(link, self._measurements, interrupted, clock=clock)
        self._keyboard = Keyboard()
        self.seconds = 0.0
        self._command = STANDSTILL

    @property
    def progress(self) -> str:
        """One line for people; another thread may read it."""
        v, omega = self._command
        held = f"  held by {in_words(self._link.gate.held)}" if self._link.gate.held else ""
        newest = self._measurements.newest
        where = "  x {:.2f} m  y {:.2f} m  θ {:.2f} rad".format(*newest.sample.pose) if newest else ""
        return printable(f"{v:+.2f} m/s  {omega:+.2f} rad/s{where}{held}")

    def wait(self) -> None:
        """Wait for bridge, permission and odometry. Raises as `SafetyMonitor.wait`."""
        self._monitor.wait()

    def run(self) -> None:
        """Drive until a key ends it.

        Raises SafetyStop, KeyboardInterrupt, and the errors of `wait` and ``Link.request_motors``; the rover
        was stopped then.
        """
        self.wait()  # what took long since the first wait is not odometry's age
        try:
            self._link.request_motors("teleop")
            self._monitor.granted()
            self._begin()
            self._terminal.discard()
            self._drive()
        finally:
            self._link.release()

    def _drive(self) -> None:
        began = due = tick_due = read = self._clock.monotonic()
        while True:
            text = self._terminal.read(max(0.0, due - self._clock.monotonic()))
            now = self._clock.monotonic()
            if now - read > LONGEST_LOOP_S:
                self._terminal.discard()
                self._keyboard.release()
                text = ""
            read = now
            if text is None:
                return
            if text and self._keyboard.take(text, now):
                return
            self._measurements.odometry(0)  # the safety monitor judges the newest
            self._monitor.check()
            velocity = self._keyboard.velocity(now)
            if now >= due or (text and velocity == STANDSTILL):
                if now >= tick_due or velocity == STANDSTILL:  # pulses last whole control ticks
                    self._command = self._dead_zone.pass_on(velocity)
                    tick_due = now + TICK_S - 0.5 * PERIOD_S
                self._link.command(self._command)
                due = now + PERIOD_S
            self.seconds = now - began


def run(
    address: BridgeAddress,
    recorder: Recorder,
    output: Output,
    *,
    robot: RobotDescription | None = None,
    topic: str | None = None,
) -> int:
    """Let a person or the commands on a ROS ``topic`` drive, and return the exit code.

    Raises RoverNcpError if the drive could not begin.
    """
    stop: SafetyStop | None = None
    code, ending = 0, "ended"
    with (
        Interrupts() as interrupts,
        recorder,
        Terminal() if topic is None else contextlib.nullcontext() as terminal,
        ZenohLink(address, recorder.put) as link,
    ):
        teleop: Teleop | TopicTeleop
        if terminal is not None:
            teleop = Teleop(link, terminal, lambda: interrupts.raised, begin=recorder.begin, robot=robot)
            words = HELP
        else:
            assert topic is not None
            commands = Inbox[RosCommand]()
            where = link.subscribe_commands(topic, commands.put)
            teleop = TopicTeleop(link, commands.take, lambda: interrupts.raised, time, begin=recorder.begin)
            words = f"passes on the commands of a ROS node on {where}"
        teleop.wait()
        output.say(link.other_model(robot))
        about = {"version": version("rover-ncp"), "robot": address.robot}
        recorder.open({TELEOP_FILE: dump_yaml(about).encode()})
        for line in words.splitlines():
            output.say(line)
        try:
            with output.live(lambda: teleop.progress):
                teleop.run()
        except SafetyStop as error:
            stop, code, ending = error, error.exit_code, str(error)
        except KeyboardInterrupt:
            code, ending = INTERRUPTED, "interrupted; the rover was stopped"
    result = TeleopResult(
        seconds=teleop.seconds,
        stopped_by=stop.rule if stop else None,
        exit_code=code,
        **recorder.fields,
    )
    if output.as_json and code:
        output.say(ending)
    lines = [f"{printable(ending)}; driven for {teleop.seconds:.0f} s"]
    if recorder.path:
        lines.append(f"recording: {recorder.path}")
    if recorder.failure:
        lines.append(f"the recording failed: {recorder.failure}")
    output.result(result, "\n".join(lines))
    return code
