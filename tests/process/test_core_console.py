"""Output without a reader: what the writer drops, keeps and counts; commands work and end all the same."""

import os
import re
import subprocess
import sys
import threading
import time

import pytest
from faults.outlet import GONE, PIPE, TERMINAL, OutletProcess

from deploy.drive.records import TICKS_TOPIC
from rover_ncp.core.console import ROOM_BYTES, Writer, printable
from rover_ncp.recording.recording import read_recording

COMMAND = [sys.executable, "-m", "rover_ncp"]
SHORT = "tests/data/short_course.yaml"


@pytest.fixture
def pipe():
    """A pipe's reading end and a writer on its other end."""
    reader, fd = os.pipe()
    yield reader, Writer(fd)
    os.close(reader)
    os.close(fd)


def read_to(reader, ending):
    """Return what the pipe holds up to and including an ending."""
    data = b""
    while not data.endswith(ending):
        data += os.read(reader, 1 << 16)
    return data.decode()


def test_full_pipe_delays_no_writer_and_every_dropped_line_is_counted(pipe):
    reader, writer = pipe
    lines = [f"line {number} {'x' * 80}\n" for number in range(5000)]
    for line in lines:  # nobody reads: a writer that waits would wait for ever
        writer.write(line.encode())
    assert not writer.drained(0.05)
    writer.put(b"the result\n", keep=True)
    said = read_to(reader, b"the result\n").splitlines(keepends=True)
    assert len("".join(said)) >= ROOM_BYTES
    number = 0
    for line in said[:-1]:
        if line.startswith("rover-ncp: lines of output dropped here: "):
            number += int(line.rsplit(" ", 1)[1])
        else:
            assert line == lines[number]
            number += 1
    assert (number, said[-1]) == (5000, "the result\n")
    assert writer.drained(1.0)


def test_end_waits_as_long_as_reader_takes_data(pipe):
    reader, writer = pipe
    left = 200_000

    def read_slowly():
        nonlocal left
        while left:
            time.sleep(0.02)
            left -= len(os.read(reader, 1 << 12))

    thread = threading.Thread(target=read_slowly)
    thread.start()
    writer.put(b"x" * 200_000, keep=True)
    assert writer.drained(0.8)  # in all it takes longer, and a busy machine may stall this reader
    thread.join()


def test_end_waits_no_longer_because_a_thread_goes_on_queueing(pipe):
    _, writer = pipe
    ended = threading.Event()

    def queue():
        while not ended.wait(0.02):
            writer.put(b"more\n", keep=True)

    writer.put(b"x" * 200_000, keep=True)
    thread = threading.Thread(target=queue)
    thread.start()
    threading.Timer(10.0, ended.set).start()
    assert not writer.drained(0.15)
    assert not ended.is_set()
    ended.set()
    thread.join()


def test_output_that_fails_is_counted_and_goes_on_once_there_is_a_reader_again(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    fd = os.open(fifo, os.O_WRONLY)
    os.close(reader)
    writer = Writer(fd)
    writer.write(b"lost\n")
    assert not writer.drained(1.0)
    assert isinstance(writer.failure, BrokenPipeError)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    writer.write(b"read\n")
    assert writer.drained(1.0)
    assert os.read(reader, 1000) == b"rover-ncp: lines of output dropped here: 1\nread\n"
    os.close(reader)
    os.close(fd)


def test_descriptor_that_another_process_made_non_blocking_loses_nothing(pipe):
    reader, writer = pipe
    os.set_blocking(writer.fileno(), False)
    writer.put(b"x" * 300_000 + b"end\n", keep=True)
    assert len(read_to(reader, b"end\n")) == 300_004


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("θ ±3 µs, Zoë", "θ ±3 µs, Zoë"),
        ("a\x1b[2J\rb", "a\\x1b[2J\\rb"),
        ("a\nready zenoh=x\x85b\u2028c", "a\\nready zenoh=x\\x85b\\u2028c"),
        ("\u202eabc\udc80", "\\u202eabc\\udc80"),
    ],
)
def test_control_characters_are_shown_as_escape_sequences(text, shown):
    assert printable(text) == shown


# Commands.


@pytest.mark.parametrize(
    "line", ["--version >/dev/full", "--version >&-", "course check parking"], ids=["full", "closed", "gone"]
)
def test_result_that_cannot_be_written_is_exit_2_and_one_line(line):
    reader, gone = os.pipe()
    os.close(reader)
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {line}', "sh", *COMMAND],
        stdout=gone,
        stderr=subprocess.PIPE,
        text=True,
        timeout=30,
        check=False,
    )
    os.close(gone)
    assert done.returncode == 2
    assert re.fullmatch(r"rover-ncp: standard output cannot be written: .+\n", done.stderr)


@pytest.mark.parametrize("locale", [{"LC_ALL": "C", "PYTHONUTF8": "0"}, {"PYTHONIOENCODING": "ascii"}])
def test_ascii_terminal_gets_escape_sequences_for_other_characters(locale):
    program = "from rover_ncp.core.console import install; out, _ = install(); print('\\xb1'); out.drained(5)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, env=os.environ | locale, timeout=60, check=True
    )
    assert (done.stdout, done.stderr) == (b"\\xb1\n", b"")


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
