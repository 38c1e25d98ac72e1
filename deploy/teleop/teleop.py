"""A person drives: keys in, commands out, through the same lease and gate as a circuit's.

Rules of this file:

1. At every end, the lease is released first, then the terminal's settings are restored.
2. Commands are sent all the time, zero when no key is held. If this process hangs, the commands stop, and the
   gate stops the rover.
3. After a delay, the loop discards the keys that arrived meanwhile and commands zero.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from deploy.drive.link import Link
from deploy.drive.measurements import Intake
from deploy.drive.safety_monitor import Guard, Interrupted
from deploy.drive.waits import Waits
from deploy.recording_buffer import Tape, progress
from deploy.teleop.keyboard import HELP, Keyboard, Press, presses
from deploy.teleop.terminal import Terminal
from rover_ncp.core.config import dump_yaml
from rover_ncp.core.console import Output, printable
from rover_ncp.core.errors import SafetyStop
from rover_ncp.core.geometry import Pose, Velocity, distance, wrap_angle
from rover_ncp.core.process import Interrupts

PERIOD_S = 0.05
HELD_UP_S = 0.25
INTERRUPTED = 130
TELEOP_FILE = "teleop.yaml"


@dataclass(frozen=True)
class Options:
    """The command line of ``rover-ncp teleop``."""

    robot: str
    record: Path | None
    overwrite: bool
    namespace: str
    zenoh_config: Path | None


@dataclass
class Driven:
    """Result of a drive: seconds, metres and radians by odometry, commands sent."""

    seconds: float = 0.0
    driven_m: float = 0.0
    turned_rad: float = 0.0
    commands: int = 0
    _last: Pose | None = field(default=None, repr=False)

    def move(self, pose: Pose) -> None:
        """Add an odometry pose."""
        if not all(map(math.isfinite, pose)):
            return
        if self._last is not None:
            self.driven_m += distance(self._last, pose)
            self.turned_rad += abs(wrap_angle(pose.theta - self._last.theta))
        self._last = pose


class Teleop:
    """One person's drive over an open link."""

    def __init__(
        self, link: Link, terminal: Terminal, interrupted: Callable[[], bool], namespace: str
    ) -> None:
        self._link, self._terminal, self._namespace = link, terminal, namespace
        self._intake = Intake(link.odometry)
        self._guard = Guard(link, self._intake, Waits(), interrupted)
        self.keyboard = Keyboard()
        self.driven = Driven()
        self._asked = Velocity(0.0, 0.0)

    @property
    def progress(self) -> str:
        """One line for people; may be asked for by another thread."""
        v, omega = self._asked
        held = f"  held by {self._link.gate.held}" if self._link.gate.held else ""
        newest = self._intake.newest
        where = "  x {:.2f} m  y {:.2f} m  θ {:.2f} rad".format(*newest.pose) if newest else ""
        return printable(f"{v:+.2f} m/s  {omega:+.2f} rad/s{where}{held}")

    def wait(self) -> None:
        """Wait for bridge, permission and odometry. Raises as `Guard.wait`."""
        self._guard.wait(drives=True, namespace=self._namespace)

    def run(self) -> None:
        """Drive until a key ends it.

        Raises SafetyStop, Interrupted, and what ``Link.request_motors`` raises; the rover was stopped then.
        """
        try:
            self._link.request_motors("teleop")
            self._guard.granted()
            self._terminal.forget()
            self._drive()
        finally:
            self._link.release()

    def _drive(self) -> None:
        began = due = read = time.monotonic()
        while True:
            text = self._terminal.read(max(0.0, due - time.monotonic()))
            now = time.monotonic()
            if now - read > HELD_UP_S:
                self._terminal.forget()
                self.keyboard.release()
                text = ""
            read = now
            if text is None:
                return
            for key in presses(text):
                if key is Press.QUIT:
                    return
                self.keyboard.press(key, now)
            sample = self._intake.take(0)
            if sample is not None:
                self.driven.move(sample.pose)
            self._guard.check()
            if now >= due or text:
                self._asked = self.keyboard.velocity(now)
                self._link.command(self._asked)
                self.driven.commands += 1
                due = now + PERIOD_S
            self.driven.seconds = now - began


def run(options: Options, output: Output) -> int:
    """Let a person drive, and return the exit code. Raises RoverNcpError if the drive could not begin."""
    tape = Tape(options.record, overwrite=options.overwrite)
    stop: SafetyStop | None = None
    interrupted = False
    with Interrupts() as interrupts:
        try:
            with (
                Terminal() as terminal,
                Link(options.robot, options.namespace, options.zenoh_config, tape.put) as link,
            ):
                teleop = Teleop(link, terminal, lambda: interrupts.raised, options.namespace)
                try:
                    teleop.wait()
                except Interrupted as interruption:
                    raise KeyboardInterrupt from interruption  # nothing has moved: the shell says the rest
                about = {"version": version("rover-ncp"), "robot": options.robot}
                tape.roll({TELEOP_FILE: dump_yaml(about).encode()})
                for line in HELP.splitlines():
                    output.say(line)
                try:
                    with progress(lambda: teleop.progress, output):
                        teleop.run()
                except SafetyStop as error:
                    stop = error
                except Interrupted:
                    interrupted = True
        finally:
            tape.close()
    fields: dict[str, Any] = {
        "seconds": teleop.driven.seconds,
        "driven_m": teleop.driven.driven_m,
        "turned_rad": teleop.driven.turned_rad,
        "keys": teleop.keyboard.count,
        "commands": teleop.driven.commands,
        "stopped_by": stop.rule if stop else None,
        "recording": str(tape.recorder.path) if tape.recorder else None,
        "recording_failure": (tape.recorder.failure or None) if tape.recorder else None,
        "exit_code": stop.exit_code if stop else INTERRUPTED if interrupted else 0,
    }
    words = (
        f"{fields['driven_m']:.2f} m and {fields['turned_rad']:.2f} rad driven in {fields['seconds']:.0f} s"
    )
    ending = str(stop) if stop else "interrupted; the rover was stopped" if interrupted else "ended"
    if output.as_json and fields["exit_code"]:
        output.say(ending)
    lines = [f"{printable(ending)}; {words}"]
    if fields["recording"]:
        lines.append(f"recording: {fields['recording']}")
    if fields["recording_failure"]:
        lines.append(f"the recording failed: {fields['recording_failure']}")
    output.result(fields, "\n".join(lines))
    return int(fields["exit_code"])
