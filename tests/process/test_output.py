"""Output that goes nowhere delays and ends no command on which a rover depends."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from faults.outlet import GONE, PIPE, TERMINAL, OutletProcess

from deploy.drive.records import TICKS_TOPIC
from rover_ncp.core.console import MAX_LINES, printable
from rover_ncp.recording.recording import read_recording

SHORT = "tests/data/short_course.yaml"
# A command that says more than its queue holds, and how long that takes on stderr.
TALKS = """
import logging, sys, time
from pydantic import BaseModel
from rover_ncp import cli
from rover_ncp.core.console import Output

class Talked(BaseModel):
    lines: int

def talk(**options):
    output = Output(False, controls=True)
    began = time.monotonic()
    for number in range(int(sys.argv[1])):
        output.say(f"{number} \\xb1\\x1b " + 80 * "x")
    logging.getLogger("a.library").warning("said")
    said_s = time.monotonic() - began
    output.result(Talked(lines=1), "the result")
    print(said_s < 0.3, file=sys.stderr, flush=True)
    return 0

cli._app = lambda: talk
sys.exit(cli.main())
"""
LINES = 5 * MAX_LINES


@pytest.mark.parametrize("reader", ["full", "takes nothing"])
def test_result_that_cannot_be_written_is_exit_2_and_delays_nothing(reader):
    fds = os.pipe()
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-c", TALKS, str(LINES)],
            stdout=full if reader == "full" else fds[1],
            stderr=subprocess.PIPE,
            timeout=30,
            check=False,
        )
    in_time, *error = done.stderr.decode().splitlines()
    os.close(fds[1])
    assert (done.returncode, in_time) == (2, "True")
    if reader != "takes nothing":  # then the error is behind the lines that wait
        assert error[0].startswith("rover-ncp: standard output cannot be written: ")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("θ ±3 µs, Zoë", "θ ±3 µs, Zoë"),
        ("\u202eabc\udc80", "\\u202eabc\\udc80"),
    ],
)
def test_control_characters_are_shown_as_escape_sequences(text, shown):
    assert printable(text) == shown


@pytest.mark.long
def test_blocked_output_keeps_no_process_from_its_work_nor_from_its_end(tmp_path):
    """Mock, bridge, viewer and driver: the output of each is blocked from its first line on."""
    processes = {}

    def start(outlet, ready, command, *arguments):
        process = processes[command] = OutletProcess(outlet, command, arguments, tmp_path)
        said = process.wait_for_line(ready) if ready else ""
        process.outlet.block()
        return said

    def end(process):
        began = time.monotonic()
        code = process.stop().code
        # A second for the output, and a second for what each ends in order anyway.
        return code, time.monotonic() - began < 2.0

    try:
        base = start(PIPE, "listening on ", "mock", "--listen", "127.0.0.1:0")
        at = ["--base", f"tcp/{base}", "--listen", "tcp/127.0.0.1:0"]
        robot = ["--robot", start(TERMINAL, "ready zenoh=", "bridge", *at).split()[0]]
        start(GONE, "watching at ", "watch", *robot, "--port", "0")
        record = tmp_path / "run.mcap"
        start(TERMINAL, "", "deploy", *robot, "--course", SHORT, "--duration", "1", "--record", str(record))
        assert processes["deploy"].wait(60.0).code == 2  # its result could not be written
        assert len(read_recording(record).topic(TICKS_TOPIC)) == 11
        ended = {name: end(processes[name]) for name in ("watch", "bridge", "mock")}
        # An interruption keeps its own code; a result that could not be written turns 0 into 2.
        assert ended == {"watch": (130, True), "bridge": (2, True), "mock": (2, True)}
    finally:
        for process in processes.values():
            if process.running:
                process.stop()
