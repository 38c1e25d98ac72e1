"""The mock as a process, on real TCP, with the real session on the bridge's own transport."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from bridge.base import BaseReport
from bridge.pioneer.session import Session
from bridge.pioneer.states import SessionState
from bridge.transport import Transport, open_transport
from rover_ncp.core.errors import NoRobot
from rover_ncp.core.geometry import Velocity
from sim.pioneer.real_time import TRUTH_COLUMNS

COMMAND = [sys.executable, "-c", "from rover_ncp.cli import main; main()", "mock"]


@contextmanager
def mock(*options: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Start a mock on a free port; killed at the end if it still runs."""
    process = subprocess.Popen(
        [*COMMAND, "--listen", "127.0.0.1:0", "--json", *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("listening on 127.0.0.1:"), line
        yield process, int(line.rsplit(":", 1)[1])
    finally:
        process.kill()
        process.communicate()


class Client:
    """A session on a transport, turned by hand in real time."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.session = Session()
        self.states: list[BaseReport] = []
        self.motion = Velocity(0.0, 0.0)
        self.session.connect(time.monotonic())

    def turn(self) -> None:
        data = self.transport.read(0.02)
        events = self.session.receive(data, time.monotonic()) if data else []
        self.session.set_motion(self.motion)
        events += self.session.tick(time.monotonic())
        self.states += [event for event in events if isinstance(event, BaseReport)]
        out = self.session.data_to_send()
        if out:
            self.transport.write(out)

    def turn_until(self, done: object, timeout: float = 10.0) -> None:
        deadline = time.monotonic() + timeout
        while not done():  # type: ignore[operator]
            assert time.monotonic() < deadline, "timed out"
            self.turn()

    @property
    def x(self) -> float:
        return self.states[-1].x if self.states else 0.0

    def drive(self, v: float, to_x: float) -> None:
        self.turn_until(lambda: self.session.state is SessionState.READY)
        self.session.enable(True)
        self.motion = Velocity(v, 0.0)
        self.turn_until(lambda: self.x > to_x)

    def leave(self) -> None:
        self.session.close(time.monotonic())
        self.transport.write(self.session.data_to_send())
        self.transport.close()


def truth_of(path: Path) -> list[dict[str, float]]:
    header, *lines = path.read_text().splitlines()
    assert header == ",".join(TRUTH_COLUMNS)
    return [dict(zip(TRUTH_COLUMNS, map(float, line.split(",")), strict=True)) for line in lines]


def wait_for_standstill(truth: Path) -> None:
    deadline = time.monotonic() + 10
    while truth.read_text().splitlines()[-1].split(",")[5] != "0.00000":
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_drive_over_tcp_and_leave(tmp_path: Path) -> None:
    truth = tmp_path / "made" / "truth.csv"
    with mock("--truth", str(truth)) as (process, port):
        client = Client(open_transport(f"tcp/127.0.0.1:{port}"))
        client.drive(0.3, to_x=0.15)
        with (
            closing(open_transport(f"tcp/127.0.0.1:{port}")) as second,
            pytest.raises(NoRobot, match="one client at a time"),
        ):
            second.read(2.0)
        client.leave()
        bytes_out, bytes_in = client.transport.bytes_out, client.transport.bytes_in
        wait_for_standstill(truth)
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=10)
    assert process.returncode == 0
    report = json.loads(out)
    assert report["connections"] == 1
    assert report["bytes_in"] == bytes_out
    assert report["bytes_out"] == bytes_in
    assert report["unknown_commands"] == report["bad_arguments"] == report["bad_checksums"] == 0
    assert not report["touched"]
    lines = truth_of(truth)
    assert lines[-1]["x"] == pytest.approx(report["pose"]["x"], abs=1e-5)
    assert lines[-1]["x"] > 0.15
    assert lines[-1]["v"] == 0.0
    assert [round(line["t_s"] * 100) for line in lines] == list(range(1, len(lines) + 1))
    steps_ns = np.diff([line["clock_ns"] for line in lines])
    assert np.abs(steps_ns - 10_000_000).max() <= 1
    wall_s = (lines[-1]["t_ns"] - lines[0]["t_ns"]) * 1e-9
    assert wall_s == pytest.approx(lines[-1]["t_s"] - lines[0]["t_s"], abs=0.05)
    assert abs(lines[-1]["t_ns"] * 1e-9 - time.time()) < 10


def test_a_client_that_vanishes_leaves_the_rover_to_the_watchdog_and_can_come_back(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    with mock("--truth", str(truth)) as (process, port):
        client = Client(open_transport(f"tcp/127.0.0.1:{port}"))
        client.drive(0.3, to_x=0.1)
        reset_connection(client.transport)
        with closing(open_transport(f"tcp/127.0.0.1:{port}")) as line:
            again = Client(line)
            again.turn_until(lambda: again.session.state is SessionState.READY)
            again.turn_until(lambda: again.states and again.states[-1].v == 0.0)
            assert again.x < 0.3
        # A kill leaves whole lines behind.
        process.kill()
        process.wait()
    assert truth.read_bytes().endswith(b"\n")
    assert truth_of(truth)[-1]["v"] == 0.0


def reset_connection(transport: Transport) -> None:
    """End a TCP connection as a crash does."""
    line = transport._socket  # type: ignore[attr-defined]
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    line.close()


def test_faults_courses_and_models_reach_the_base() -> None:
    with mock("--fault", "mute@0.5", "--model", "p3dx", "--course", "parking") as (process, port):
        with closing(open_transport(f"tcp/127.0.0.1:{port}")) as line:
            client = Client(line)
            client.turn_until(lambda: client.session.state is SessionState.READY)
            client.session.enable(True)
            client.turn_until(lambda: client.session.state is SessionState.LOST)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=10)
    assert process.returncode == 0
    assert json.loads(out)["model"] == "p3dx"


def refused(*options: str) -> tuple[int, str]:
    done = subprocess.run([*COMMAND, *options], capture_output=True, text=True, timeout=30, check=False)
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    return done.returncode, done.stderr


def test_a_port_in_use_and_a_truth_that_cannot_be_written() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        code, text = refused("--listen", f"127.0.0.1:{taken.getsockname()[1]}")
    assert code == 2
    assert "another process listens there" in text
    code, text = refused("--listen", "127.0.0.1:0", "--truth", "/dev/null/truth.csv")
    assert (code, text.count("\n")) == (2, 1)
    assert "/dev/null/truth.csv" in text


def test_running_mock_takes_faults_from_its_input_and_answers_when_they_began(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    with mock("--fault", "-", "--truth", str(truth)) as (process, _):
        assert process.stdin is not None and process.stderr is not None
        began_ns = time.monotonic_ns()
        process.stdin.write("explode\nmute\n")
        process.stdin.close()  # the end of the input does not end the mock
        process.stdin = None
        assert "expected NAME" in process.stderr.readline()
        word, moment, _, fault = process.stderr.readline().split()
        ended_ns = time.monotonic_ns()
        assert (word, fault) == ("applied", "mute")
        # The beginning of a step, on the machine's monotonic clock, as the rows of the truth are.
        moment_ns = int(moment.removeprefix("t_ns="))
        assert began_ns - 10_000_000 <= moment_ns <= ended_ns
        deadline = time.monotonic() + 10
        while not (rows := truth_of(truth)):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert abs((moment_ns - rows[0]["clock_ns"] + 5e6) % 10e6 - 5e6) < 1e3
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=10)
    assert json.loads(out)["connections"] == 0
