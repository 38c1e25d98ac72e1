"""Output that goes nowhere delays and ends no command on which a rover depends."""

import os
import subprocess
import sys

import pytest

from rover_ncp.core.console import MAX_LINES, printable

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


def test_result_that_no_reader_takes_is_exit_2_and_delays_nothing():
    fds = os.pipe()
    done = subprocess.run(
        [sys.executable, "-c", TALKS, str(LINES)],
        stdout=fds[1],
        stderr=subprocess.PIPE,
        timeout=30,
        check=False,
    )
    os.close(fds[1])
    assert (done.returncode, done.stderr.decode().splitlines()[0]) == (2, "True")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("θ ±3 µs, Zoë", "θ ±3 µs, Zoë"),
        ("\u202eabc\udc80", "\\u202eabc\\udc80"),
    ],
)
def test_control_characters_are_shown_as_escape_sequences(text, shown):
    assert printable(text) == shown
