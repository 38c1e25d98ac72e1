"""Driving by keyboard over a pseudo-terminal: mock and bridge as real processes, and simulated keys."""

import contextlib
import json
import os
import pty
import subprocess
import sys
import termios
import time

import pytest
from kit.bridge_bench import MACHINE_S, braking_s, wait_for
from kit.true_motion import speed, stood_after

from deploy.keyboard import V_M_S
from rover_ncp.recording.recording import read_recording

# As in a shell: the terminal is the process's own, so that Ctrl-C is a signal.
IN_ITS_TERMINAL = (
    "import fcntl, runpy, termios; "
    "fcntl.ioctl(0, termios.TIOCSCTTY, 0); runpy.run_module('rover_ncp', run_name='__main__')"
)


class Person:
    """Sits at a terminal in which teleop runs."""

    def __init__(self, rig, folder, *options, screen_full=False):
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        self._out, self._err = folder / "teleop.json", folder / "teleop.log"
        if screen_full:
            self._fill_screen()
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.process = subprocess.Popen(
                [sys.executable, "-c", IN_ITS_TERMINAL, "teleop", "--robot", rig.robot, "--json", *options],
                stdin=self.slave,
                stdout=self.slave if screen_full else out,
                stderr=self.slave if screen_full else err,
                start_new_session=True,
            )
        if not screen_full:
            wait_for(lambda: "release it to stop" in self.said, 30.0)
        wait_for(lambda: self.settings != self.before, 30.0)

    def _fill_screen(self):
        """Write to the terminal until it takes no more; nothing reads the other end."""
        fd = os.open(os.ttyname(self.slave), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(fd, bytes(1000))
        os.close(fd)

    @property
    def said(self):
        return self._err.read_text()

    @property
    def settings(self):
        return termios.tcgetattr(self.slave)

    def type(self, text):
        os.write(self.master, text.encode())
        return time.monotonic_ns()

    def end(self, timeout_s=10.0):
        code = self.process.wait(timeout_s)
        result = json.loads(self._out.read_text())
        return code, result

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def sit_down(rig, tmp_path):
    people = []

    def sit_down(*options, **screen):
        people.append(Person(rig, tmp_path, *options, **screen))
        return people[-1]

    yield sit_down
    for person in people:
        person.close()


def test_ctrl_c_stops_the_rover_and_the_terminal_is_as_before(rig, sit_down, tmp_path):
    person = sit_down("--record", str(tmp_path / "run.mcap"))
    wait_for(lambda: person.type("i") and speed(rig.truth) > 0.05, 15.0)
    left_ns = person.type("\x03")
    code, result = person.end()
    assert (code, result["stopped_by"]) == (130, None)
    assert person.settings == person.before
    assert stood_after(rig.truth, left_ns) < 0.2 + braking_s(V_M_S) + MACHINE_S
    assert result["seconds"] > 0.0
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert {"odom", "cmd_vel", "rover/cmd_out", "rover/gate"} <= {m.topic for m in recording.messages}
