"""Lines to a base: bytes both ways, and one clear error when a line breaks."""

import os
import pty
import socket
import struct
import subprocess
import sys
import time
import tty
from contextlib import closing, contextmanager, suppress

import pytest

from bridge.pioneer import connection
from bridge.pioneer.connection import BACKLOG_S, open_transport
from bridge.pioneer.framing import Command, encode_command
from rover_ncp.core.errors import NoRobot


@contextmanager
def tcp_pair(buffer=0):
    """Give a TCP transport and the far end, whose buffer may be small."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        if buffer:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        line = open_transport(f"tcp/127.0.0.1:{server.getsockname()[1]}")
        far, _ = server.accept()
        # Else a report waits until the one before is acknowledged, which takes longer on a line that is full.
        far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with closing(line), far:
            yield line, far


@contextmanager
def serial_pair():
    """Give a serial transport on a pseudo-terminal, and the far end's descriptor."""
    far, near = pty.openpty()
    tty.setraw(near)
    line = open_transport(f"serial/{os.ttyname(near)}#baudrate=38400")
    os.close(near)
    try:
        with closing(line):
            yield line, far
    finally:
        os.close(far)


def read_all(line, size):
    data, deadline = b"", time.monotonic() + 5
    while len(data) < size and time.monotonic() < deadline:
        data += line.read(0.1)
    return data


PAIRS = pytest.mark.parametrize("pair", [tcp_pair, serial_pair])


@PAIRS
def test_bytes_go_both_ways_and_are_counted(pair):
    with pair() as (line, far):
        fd = far if pair is serial_pair else far.fileno()
        everything = bytes(range(256)) * 4
        os.write(fd, everything)
        assert read_all(line, len(everything)) == everything
        line.write(b"\r\n\x03\x11\x13\xff")
        assert os.read(fd, 20) == b"\r\n\x03\x11\x13\xff"
        assert line.bytes_out == 6


def test_refused_connection_is_no_robot_with_the_reason():
    for endpoint, reason in [
        ("tcp/127.0.0.1:1", "tcp/127.0.0.1:1: connection refused"),
        ("serial//dev/no-such-port", "serial//dev/no-such-port#baudrate=9600: No such file"),
    ]:
        with pytest.raises(NoRobot, match=reason):
            open_transport(endpoint)


@pytest.mark.parametrize(("linger", "words"), [(0, "closed the connection"), (1, "reset")])
def test_a_base_that_hangs_up_or_resets_the_connection_is_no_robot(linger, words):
    with tcp_pair() as (line, far):
        far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", linger, 0))
        far.close()
        with pytest.raises(NoRobot, match=words):
            read_all(line, 1)


@PAIRS
def test_a_line_that_takes_no_more_bytes_is_no_robot(pair):
    """The far end reads nothing: commands must not pile up to be carried out later."""
    with pair() as (line, _), pytest.raises(NoRobot, match="takes no more bytes"):
        for _ in range(100_000):
            line.write(bytes(4096))


def test_a_tcp_line_that_takes_nothing_while_packets_still_come_is_given_up_and_drops_what_it_holds():
    """The far end's window is closed: what the line holds back would be old setpoints when it opens again."""
    with tcp_pair(buffer=1) as (line, far):  # the system takes its minimum
        deadline = time.monotonic() + 10 * BACKLOG_S
        with pytest.raises(NoRobot, match="takes no more bytes"):
            while time.monotonic() < deadline:
                line.write(bytes(100))
                far.sendall(b"report")
                assert line.read(0.1) == b"report"
                time.sleep(0.02)
        written = line.bytes_out
        with pytest.raises(NoRobot, match="takes no more bytes"):  # nothing more goes out
            line.write(bytes(100))
        assert line.bytes_out == written
        line.abort()
        arrived = 0
        with suppress(ConnectionResetError):
            while data := far.recv(4096):
                arrived += len(data)
    assert arrived < written


def test_a_slow_tcp_line_that_acknowledges_bytes_is_not_given_up(monkeypatch):
    """Bytes are outstanding at every write, but each time others."""
    now_s = 100.0
    with tcp_pair() as (line, _):
        monkeypatch.setattr(connection.time, "monotonic", lambda: now_s)
        monkeypatch.setattr(line, "_outstanding", lambda: min(line.bytes_out, 18))
        for _ in range(50):
            line.write(bytes(18))
            now_s += 0.4
        monkeypatch.setattr(line, "_outstanding", lambda: line.bytes_out - 18 * 50)
        line.write(bytes(18))  # all that was written before is acknowledged
        now_s += BACKLOG_S + 0.01
        with pytest.raises(NoRobot, match="takes no more bytes"):
            line.write(bytes(18))


def test_the_last_command_arrives_although_sips_lie_unread():
    """Closing over unread bytes resets a connection, and a reset throws away what was on its way."""
    with tcp_pair() as (line, far):
        far.sendall(bytes(5000))
        line.write(encode_command(Command.CLOSE))
        line.close()
        far.settimeout(2.0)
        assert far.recv(100) == encode_command(Command.CLOSE)


def test_port_that_another_process_has_locked_is_named():
    far, near = pty.openpty()
    name = os.ttyname(near)
    lock = "import fcntl, sys; port = open(sys.argv[1]); fcntl.flock(port, 2); print(flush=True); input()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", lock, name], **pipes) as other:
        other.stdout.readline()
        with pytest.raises(NoRobot, match="another process uses it"):
            open_transport(f"serial/{name}")
        other.communicate(b"\n")
    open_transport(f"serial/{name}").close()
    os.close(far)
    os.close(near)
