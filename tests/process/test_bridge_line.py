"""The line to the base: its thread hands bytes and errors to the loop."""

import socket
import threading
import time
from contextlib import suppress

import pytest

from bridge.inbox import MAX_MESSAGES, CommandMessage, Inbox, Query, RobotMessage
from bridge.pioneer import connection
from bridge.pioneer.connection import BaseConnection, Broken, Opened, Received, TcpTransport
from sim.park.live import wait_for


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(connection, "RETRY_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        yield server


@pytest.fixture
def open_line(server):
    lines = []

    def open_it():
        inbox = Inbox()
        lines.append(BaseConnection(f"tcp/127.0.0.1:{server.getsockname()[1]}", inbox))
        return lines[-1], inbox

    yield open_it
    for line in lines:
        line.close()
        line._thread.join(5.0)  # a busy machine ends it later than `close` waits
        assert not line._thread.is_alive()


def next_of(inbox, kind):
    """Take arrivals until one of that kind comes."""
    return wait_for(lambda: next((each for _, each in inbox.take(0.1) if isinstance(each, kind)), None))


@pytest.fixture
def opened(server, open_line):
    """A line in use, its inbox and the base's end."""
    line, inbox = open_line()
    peer, _ = server.accept()
    with peer:
        next_of(inbox, Opened)
        line.use()
        yield line, inbox, peer


def assert_opened_again(server, line, inbox):
    second, _ = server.accept()
    with second:
        next_of(inbox, Opened)
        line.use()
        line.write(b"again")
        assert second.recv(100) == b"again"


def test_a_broken_line_is_reported_and_opened_again(server, opened):
    line, inbox, first = opened
    line.write(b"12345")
    first.recv(5)
    first.close()
    assert "closed the connection" in str(next_of(inbox, Broken).error)
    line.drop()
    line.write(b"lost")
    assert_opened_again(server, line, inbox)


def test_a_line_that_is_reopened_is_closed_by_the_thread_and_the_loop_never_waits(
    server, opened, monkeypatch
):
    line, inbox, first = opened
    line.reopen("no answer")
    assert str(next_of(inbox, Broken).error) == f"{line.endpoint}: no answer"
    closed_by, abort = [], TcpTransport.abort
    monkeypatch.setattr(
        TcpTransport, "abort", lambda self: closed_by.append(threading.current_thread()) or abort(self)
    )
    line.drop()
    first.settimeout(2.0)
    with pytest.raises(ConnectionResetError):  # bytes on their way are dropped
        first.recv(100)
    assert closed_by
    assert threading.main_thread() not in closed_by
    assert_opened_again(server, line, inbox)


def test_line_that_does_not_take_the_last_zeros_delivers_no_setpoints_after_its_end(
    server, open_line, monkeypatch
):
    monkeypatch.setattr(connection, "BACKLOG_S", 0.05)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line, inbox = open_line()
    peer, _ = server.accept()
    with peer:
        peer.settimeout(2.0)
        next_of(inbox, Opened)
        line.use()
        sent = 0
        while line._broken is None:
            line.write(b"setpoint" * 500)
            sent += 4000
            time.sleep(0.01)
        line.write(b"zero")
        line.close()
        received = 0
        with suppress(ConnectionResetError):
            while data := peer.recv(1 << 16):
                received += len(data)
    assert received < sent


def test_flood_of_one_origin_drops_no_messages_of_others():
    def query(name):
        return Query(name, b"", None, print, print)

    floods = [CommandMessage(b""), query("rover/motors"), RobotMessage("scan", b"", 0.0)]
    stop, odom = (RobotMessage(name, b"", 0.0) for name in ("stop", "odom"))
    others = [query("rover/stop"), stop, odom, Received(b"sip")]
    inbox = Inbox()
    for flood in floods * (MAX_MESSAGES + 1):
        inbox.put(flood)
    for other in others:
        inbox.put(other)
    arrivals = [arrival for _, arrival in inbox.take(0.0)]
    assert arrivals == floods * MAX_MESSAGES + others
    assert inbox.flooded == len(floods)
    inbox.put(floods[0])
    assert [arrival for _, arrival in inbox.take(0.0)] == floods[:1]
