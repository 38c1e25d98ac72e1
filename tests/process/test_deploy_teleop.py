"""Driving by keyboard over a pseudo-terminal: mock and bridge as real processes, and simulated keys."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from itertools import pairwise

import pytest
from kit.bridge_bench import MACHINE_S, Rig, braking_s, wait_for
from kit.json_fields import undescribed

from deploy.keyboard import V_M_S
from rover_ncp import cli
from rover_ncp.course.course import load_course
from rover_ncp.recording.recording import read_recording

REPEAT_S, DELAY_S = 0.033, 0.3
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
                [sys.executable, "-c", IN_ITS_TERMINAL, "teleop", "--robot", rig.locator, "--json", *options],
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
        return time.time_ns()

    def hold(self, key, seconds):
        """Send a held key as a terminal does; return when it was sent last, in ns."""
        end = time.monotonic() + seconds
        last = self.type(key)
        time.sleep(DELAY_S)
        while time.monotonic() < end:
            last = self.type(key)
            time.sleep(REPEAT_S)
        return last

    def end(self, timeout_s=10.0):
        code = self.process.wait(timeout_s)
        result = json.loads(self._out.read_text())
        assert not undescribed("teleop", result)
        return code, result

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


@pytest.fixture
def sit_down(rig, tmp_path):
    people = []

    def sit_down(*options, **screen):
        people.append(Person(rig, tmp_path, *options, **screen))
        return people[-1]

    yield sit_down
    for person in people:
        person.close()


def moved_since(rig, began_ns):
    """Return how far the rover drove and turned in truth, and how far along x it came: m, rad, m."""
    states = [state for state in rig.truth.read() if state.wall_ns >= began_ns]
    steps = [((b.wall_ns - a.wall_ns) * 1e-9, b.velocity) for a, b in pairwise(states)]
    driven, turned = (sum(dt * abs(velocity[i]) for dt, velocity in steps) for i in range(2))
    return driven, turned, states[-1].pose.x - states[0].pose.x


@pytest.mark.long
def test_it_drives_while_a_key_repeats_and_stands_when_it_is_released(rig, sit_down, tmp_path):
    record, made = tmp_path / "run.mcap", tmp_path / "driven.yaml"
    person, began_ns = sit_down("--record", str(record)), time.time_ns()
    for key, seconds in (("i", 1.5), ("u", 2.5), ("\x1b[A", 1.5)):
        last_ns = person.hold(key, seconds)
        if key == "i":
            assert rig.speed_at(last_ns) == pytest.approx(V_M_S, abs=0.002)
        stood = rig.stood_after(last_ns)
        assert 0.3 < stood < 0.5 + braking_s(V_M_S) + MACHINE_S
    # A single press is a small step, and no more.
    before = rig.truth.read()[-1].pose.x
    last_ns = person.type("i")
    assert rig.stood_after(last_ns) < 0.5 + braking_s(V_M_S) + MACHINE_S
    assert 0.005 < abs(rig.truth.read()[-1].pose.x - before) < 0.06
    # Another key stops at once.
    person.hold("i", 1.0)
    last_ns = person.type("k")
    assert rig.stood_after(last_ns) < braking_s(V_M_S) + 0.1 + MACHINE_S

    person.type("q")
    code, result = person.end()
    assert (code, result["exit_code"], result["stopped_by"]) == (0, 0, None)
    assert person.settings == person.before
    driven, turned, along = moved_since(rig, began_ns)
    assert driven > 0.6
    assert result["driven_m"] == pytest.approx(driven, abs=0.01)
    assert turned > 0.14 * 2.0
    assert result["turned_rad"] == pytest.approx(turned, abs=0.01)
    recording = read_recording(record)
    assert recording.complete
    assert {"odom", "cmd_vel", "rover/cmd_out", "rover/gate"} <= {m.topic for m in recording.messages}

    assert cli.run(["course", "new", str(record), "--out", str(made)]) == 0
    assert cli.run(["course", "check", str(made), "--out", str(tmp_path / "driven.png")]) == 0
    assert load_course(made).goal.x == pytest.approx(along, abs=0.01)
    assert cli.run(["eval", "course", "--course", str(made)]) == 0


def test_ctrl_c_stops_the_rover_and_the_terminal_is_as_before(rig, sit_down):
    person = sit_down()
    wait_for(lambda: person.type("i") and rig.truth.speed() > 0.05, 15.0)
    left_ns = person.type("\x03")
    code, result = person.end()
    assert (code, result["stopped_by"]) == (130, None)
    assert person.settings == person.before
    assert rig.stood_after(left_ns) < 0.2 + braking_s(V_M_S) + MACHINE_S


def test_screen_that_takes_no_output_delays_neither_key_nor_end(rig, sit_down):
    person = sit_down(screen_full=True)
    wait_for(lambda: person.type("i") and rig.truth.speed() > 0.05, 15.0)
    left_ns = time.time_ns()
    person.process.send_signal(signal.SIGTERM)
    assert rig.stood_after(left_ns) < 0.2 + braking_s(V_M_S) + MACHINE_S
    assert person.process.wait(2.0) == 130
    assert person.settings == person.before
