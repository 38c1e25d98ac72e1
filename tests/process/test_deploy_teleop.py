"""Driving by keyboard over a pseudo-terminal: mock and bridge as real processes, and simulated keys."""

import json
import os
import pty
import subprocess
import sys
import termios
import time

from kit.bridge_bench import MACHINE_S, braking_s, wait_for
from kit.true_motion import speed, stood_after

from deploy.keyboard import V_M_S
from rover_ncp.recording.recording import read_recording

# As in a shell: the terminal is the process's own, so that Ctrl-C is a signal.
IN_ITS_TERMINAL = (
    "import fcntl, runpy, termios; "
    "fcntl.ioctl(0, termios.TIOCSCTTY, 0); runpy.run_module('rover_ncp', run_name='__main__')"
)


def test_ctrl_c_stops_the_rover_and_the_terminal_is_as_before(rig, tmp_path):
    keyboard, terminal = pty.openpty()
    before, log = termios.tcgetattr(terminal), tmp_path / "teleop.log"
    options = ["--robot", rig.robot, "--json", "--record", str(tmp_path / "run.mcap")]

    def drives():
        os.write(keyboard, b"i")
        return speed(rig.truth) > 0.05

    with log.open("wb") as said:
        teleop = subprocess.Popen(
            [sys.executable, "-c", IN_ITS_TERMINAL, "teleop", *options],
            stdin=terminal,
            stdout=subprocess.PIPE,
            stderr=said,
            start_new_session=True,
        )
    try:
        wait_for(lambda: "release it to stop" in log.read_text(), 30.0)
        wait_for(lambda: termios.tcgetattr(terminal) != before, 30.0)
        wait_for(drives, 15.0)
        os.write(keyboard, b"\x03")
        left_ns = time.monotonic_ns()
        result = json.loads(teleop.communicate(timeout=10.0)[0])
        assert (teleop.returncode, result["stopped_by"]) == (130, None)
        assert termios.tcgetattr(terminal) == before
    finally:
        teleop.kill()
        teleop.communicate()
        os.close(keyboard)
        os.close(terminal)
    assert stood_after(rig.truth, left_ns) < 0.2 + braking_s(V_M_S) + MACHINE_S
    assert result["seconds"] > 0.0
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert {"odom", "cmd_vel", "rover/cmd_out", "rover/gate"} <= {m.topic for m in recording.messages}
