"""Lines to a base: bytes both ways, and one clear error when a line breaks."""

import os
import pty
import select
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
from pioneer_bench import Pioneer

from bridge.base import BaseReport, Lost
from bridge.pioneer.arcos import Command, encode_command
from bridge.pioneer.session import Session
from bridge.pioneer.states import SessionState
from bridge.transport import DEFAULT_PORT, Transport, open_transport
from rover_ncp.core.errors import NoRobot, UsageError
from rover_ncp.core.geometry import Velocity


@contextmanager
def tcp_pair() -> Iterator[tuple[Transport, socket.socket]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = open_transport(f"tcp/127.0.0.1:{server.getsockname()[1]}")
        far, _ = server.accept()
        with closing(line), far:
            yield line, far


@contextmanager
def serial_pair() -> Iterator[tuple[Transport, int]]:
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


def read_all(line: Transport, size: int) -> bytes:
    data, deadline = b"", time.monotonic() + 5
    while len(data) < size and time.monotonic() < deadline:
        data += line.read(0.1)
    return data


def test_bytes_go_both_ways_over_tcp_and_are_counted() -> None:
    with tcp_pair() as (line, far):
        everything = bytes(range(256)) * 40
        far.sendall(everything)
        assert read_all(line, len(everything)) == everything
        line.write(b"abc")
        assert far.recv(10) == b"abc"
        assert (line.bytes_in, line.bytes_out) == (len(everything), 3)


def test_bytes_go_both_ways_over_a_serial_line_and_are_counted() -> None:
    with serial_pair() as (line, far):
        everything = bytes(range(256)) * 4
        os.write(far, everything)
        assert read_all(line, len(everything)) == everything
        line.write(b"\r\n\x03\x11\x13\xff")
        assert os.read(far, 20) == b"\r\n\x03\x11\x13\xff"
        assert (line.bytes_in, line.bytes_out) == (len(everything), 6)


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_reading_waits_no_longer_than_asked(kind: str) -> None:
    with tcp_pair() if kind == "tcp" else serial_pair() as (line, _):
        start, cpu = time.monotonic(), time.process_time()
        assert line.read(0.2) == b""
        assert 0.15 < time.monotonic() - start < 1.0
        assert time.process_time() - cpu < 0.1


def test_commands_leave_at_once() -> None:
    with tcp_pair() as (line, _):
        option = line._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)  # type: ignore[attr-defined]
        assert option != 0


def test_refused_connection_is_no_robot_with_the_reason() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = server.getsockname()[1]
    for endpoint, reason in [
        (f"tcp/127.0.0.1:{free}", f"tcp/127.0.0.1:{free}: connection refused"),
        ("tcp/no.such.host.invalid", r"tcp/no.such.host.invalid:8101: "),
        ("serial//dev/no-such-port", "serial//dev/no-such-port#baudrate=9600: No such file"),
        ("serial//dev/null", "serial//dev/null#baudrate=9600: "),
    ]:
        with pytest.raises(NoRobot, match=reason) as caught:
            open_transport(endpoint)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "endpoint",
    [
        *("", "tcp", "tcp/", "tcp/host:0", "tcp/host:99999", "tcp/host:a", "tcp/host:80#x=1", "udp/host"),
        *("serial/", "serial//dev/ttyUSB0#baud=9600", "serial//dev/ttyUSB0#baudrate=fast", "/dev/ttyUSB0"),
    ],
)
def test_an_endpoint_of_another_form_is_a_usage_error(endpoint: str) -> None:
    with pytest.raises(UsageError, match="expected tcp/HOST"):
        open_transport(endpoint)


def test_the_port_of_a_base_is_8101(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def refuse(address: tuple[str, int], timeout: float) -> socket.socket:
        asked.append(address)
        raise ConnectionRefusedError

    monkeypatch.setattr(socket, "create_connection", refuse)
    for endpoint in ("tcp/robot", "tcp/[::1]", "tcp/[::1]:7"):
        with pytest.raises(NoRobot):
            open_transport(endpoint)
    assert asked == [("robot", DEFAULT_PORT), ("::1", DEFAULT_PORT), ("::1", 7)]


def test_a_base_that_hangs_up_is_no_robot() -> None:
    with tcp_pair() as (line, far):
        far.close()
        with pytest.raises(NoRobot, match="closed the connection"):
            read_all(line, 1)


def test_a_connection_that_is_reset_is_no_robot() -> None:
    with tcp_pair() as (line, far):
        far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        far.close()
        with pytest.raises(NoRobot, match="reset"):
            read_all(line, 1)


def test_an_unplugged_cable_is_no_robot() -> None:
    with serial_pair() as (line, far):
        spare = os.open(os.devnull, os.O_RDONLY)
        os.dup2(spare, far)
        os.close(spare)
        with pytest.raises(NoRobot, match="serial/"):
            read_all(line, 1)
        with pytest.raises(NoRobot, match="serial/"):
            for _ in range(10):
                line.write(b"x" * 1000)


@pytest.mark.parametrize("kind", ["tcp", "serial"])
def test_a_line_that_takes_no_more_bytes_is_no_robot_and_no_write_waits_for_it(kind: str) -> None:
    """The far end reads nothing: commands must not pile up to be carried out later."""
    longest_s = 0.0

    def flood(line: Transport) -> None:
        nonlocal longest_s
        for _ in range(100_000):
            began_s = time.monotonic()
            try:
                line.write(bytes(4096))
            finally:
                longest_s = max(longest_s, time.monotonic() - began_s)

    with (
        tcp_pair() if kind == "tcp" else serial_pair() as (line, _),
        pytest.raises(NoRobot, match="takes no more bytes"),
    ):
        flood(line)
    assert longest_s < 0.25  # the machine's delay; a write with a timeout took 0.5 s


def test_the_last_command_arrives_although_sips_lie_unread() -> None:
    """Closing over unread bytes resets a connection, and a reset throws away what was on its way."""
    with tcp_pair() as (line, far):
        far.sendall(bytes(5000))
        line.write(encode_command(Command.CLOSE))
        line.close()
        far.settimeout(2.0)
        assert far.recv(100) == encode_command(Command.CLOSE)


class Base(threading.Thread):
    """A mock Pioneer behind a pseudo-terminal, in real time; ends on request or when its line is gone."""

    def __init__(self, far: int, *faults: str) -> None:
        super().__init__()
        self.pioneer = Pioneer("p3at-sh", *faults)
        self.ending = threading.Event()
        self._far = far

    def run(self) -> None:
        start, firmware = time.monotonic(), self.pioneer.firmware
        while not self.ending.is_set():
            readable, _, _ = select.select([self._far], [], [], 0.01)
            now = time.monotonic() - start
            firmware.advance(now)
            if readable:
                firmware.receive(os.read(self._far, 4096), now)
            os.write(self._far, firmware.data_to_send())


@contextmanager
def base_on_a_serial_line(*faults: str) -> Iterator[tuple[Transport, Base]]:
    with serial_pair() as (line, far):
        base = Base(far, *faults)
        base.start()
        try:
            yield line, base
        finally:
            base.ending.set()
            base.join()


def turn(
    session: Session, line: Transport, until: object, timeout: float = 10.0
) -> list[tuple[float, object]]:
    """Let a session run until ``until()``; return its events and when they came."""
    deadline, happened = time.monotonic() + timeout, []
    while not until():  # type: ignore[operator]
        assert time.monotonic() < deadline, "timed out"
        data = line.read(0.02)
        events = session.receive(data, time.monotonic()) if data else []
        events += session.tick(time.monotonic())
        happened += [(time.monotonic(), event) for event in events]
        line.write(session.data_to_send())
    return happened


def test_a_base_on_a_serial_line_is_connected_driven_and_left() -> None:
    with base_on_a_serial_line() as (line, base):
        session = Session()
        session.connect(time.monotonic())
        line.write(b"WMS2\r")  # what ARIA sends first
        turn(session, line, lambda: session.state is SessionState.READY)
        session.enable(True)
        turn(session, line, lambda: base.pioneer.firmware.drive.enabled)
        turn(
            session, line, lambda: session.set_motion(Velocity(0.3, 0.0)) or base.pioneer.rover.pose.x > 0.02
        )
        session.close(time.monotonic())
        line.write(session.data_to_send())
        deadline = time.monotonic() + 5
        while base.pioneer.speed or base.pioneer.firmware.drive.enabled:
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_base_on_a_bad_serial_line_that_falls_silent_is_lost_in_time() -> None:
    with base_on_a_serial_line("corrupt=0.05", "drop=0.05", "noise=0.05", "mute@0.7") as (line, _):
        session = Session()
        session.connect(time.monotonic())
        turn(session, line, lambda: session.state is SessionState.READY, timeout=30)
        session.enable(True)
        happened = turn(session, line, lambda: session.state is SessionState.LOST)
        (reported_s, _), (lost_s, lost) = [
            item for item in happened if isinstance(item[1], BaseReport | Lost)
        ][-2:]
        assert lost_s - reported_s < 0.7
        assert isinstance(lost, Lost)


def test_a_serial_line_behind_a_url_of_pyserial_carries_bytes_both_ways():
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = open_transport(f"serial/socket://127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            line.write(b"command")
            assert peer.recv(100) == b"command"
            peer.sendall(b"report")
            assert b"".join(iter(lambda: line.read(0.2), b"")) == b"report"
        line.close()
