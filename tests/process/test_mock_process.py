"""The mock as a process, on real TCP: clients that vanish, faults from its input, its end."""

import signal
import socket
import time
from contextlib import ExitStack, closing

import pytest
from kit.true_motion import moving

from bridge.pioneer.connection import open_transport
from bridge.pioneer.framing import Command, Decoder, encode_command, encode_frame
from bridge.pioneer.packets import Kind, decode_names
from sim.park.live import Process, wait_for
from sim.park.truth import TruthReader


@pytest.fixture
def mock(tmp_path):
    """Start a mock on a free port; return it and the endpoint for its client."""
    with ExitStack() as running:

        def start(*options, reads_lines=False):
            arguments = ["--listen", "127.0.0.1:0", *options]
            process = running.enter_context(Process("mock", arguments, tmp_path, reads_lines=reads_lines))
            return process, f"tcp/{process.wait_for_line('listening on ')}"

        yield start


def greet(line):
    """Open a session as a client does and wait for a report; return the names of the base."""
    decoder = Decoder()

    def names():
        # In an open session these frames are PULSE, OPEN and CLOSE. After a late answer, or in the session of
        # an earlier client, they close it, and all has to be sent again.
        for kind in (0, 1, 2):
            line.write(encode_frame(kind))
        packets = decoder.feed(line.read(0.5), time.monotonic())
        found = next((decode_names(packet.payload) for packet in packets if packet.kind == Kind.SYNC2), None)
        if found is not None:
            line.write(encode_command(Command.OPEN))
        return found if found is not None and line.read(2.0) else None

    return wait_for(names)


def reset(line):
    """End a TCP connection as a crash does."""
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    line.close()


def test_a_client_that_vanishes_can_come_back_to_the_chosen_base_and_a_kill_leaves_whole_lines(
    mock, tmp_path
):
    truth = tmp_path / "made" / "truth.csv"
    options = ["--fault", "mute@0.2", "--model", "p3dx", "--course", "parking", "--truth", str(truth)]
    process, endpoint = mock(*options)
    line = open_transport(endpoint)
    greet(line)
    reset(line._socket)
    with closing(open_transport(endpoint)) as line:
        assert "p3dx" in greet(line)
        line.write(encode_command(Command.ENABLE, 1))
        wait_for(lambda: not line.read(0.5))  # its SIPs come every 0.1 s until it is mute
    process.send_signal(signal.SIGKILL)
    process.wait(5.0)
    assert truth.read_bytes().endswith(b"\n")
    assert not moving(TruthReader(truth).read()[-1])


def test_running_mock_takes_faults_from_its_input_and_answers_when_they_began(mock, tmp_path):
    truth = tmp_path / "truth.csv"
    process, _ = mock("--fault", "-", "--truth", str(truth), reads_lines=True)
    began_ns = time.monotonic_ns()
    moment_ns = process.tell("explode\nmute").t_ns
    # The beginning of a step, on the machine's monotonic clock, as the rows of the truth are.
    assert began_ns - 10_000_000 <= moment_ns <= time.monotonic_ns()
    states = wait_for(TruthReader(truth).read)
    assert abs((moment_ns - states[0].clock_ns + 5e6) % 10e6 - 5e6) < 1e3
    log = (tmp_path / "mock.log").read_text().splitlines()
    assert "expected NAME" in log[1]
    assert log[2].endswith(" mute")
    assert process.stop().code == 0
