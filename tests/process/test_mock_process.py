"""The mock as a process, on real TCP, with the real session on the bridge's own transport."""

import signal
import socket
import time
from contextlib import ExitStack, closing

import numpy as np
import pytest
from kit.pioneer_bench import Pioneer

from bridge.base import BaseReport, Ready
from bridge.pioneer.session import Session
from bridge.pioneer.states import SessionState
from bridge.pioneer.transport import open_transport
from rover_ncp.cli import run
from rover_ncp.core.errors import NoRobot
from rover_ncp.core.geometry import Velocity
from sim.live.processes import Process, wait_for
from sim.pioneer.real_time import TRUTH_COLUMNS
from sim.pioneer.server import Server


@pytest.fixture
def mock(tmp_path):
    """Start a mock on a free port; return it and the endpoint for its client."""
    with ExitStack() as running:

        def start(*options, reads_lines=False):
            arguments = ["--listen", "127.0.0.1:0", *options]
            process = running.enter_context(Process("mock", arguments, tmp_path, reads_lines=reads_lines))
            return process, f"tcp/{process.wait_for_line('listening on ')}"

        yield start


class Client:
    """A session on a transport, turned by hand in real time."""

    def __init__(self, transport):
        self.transport = transport
        self.session = Session()
        self.states, self.model, self.bytes_in = [], "", 0
        self.motion = Velocity(0.0, 0.0)
        self.session.connect(time.monotonic())

    def turn(self):
        data = self.transport.read(0.02)
        self.bytes_in += len(data)
        events = self.session.receive(data, time.monotonic()) if data else []
        self.session.set_motion(self.motion)
        events += self.session.tick(time.monotonic())
        self.states += [event for event in events if isinstance(event, BaseReport)]
        self.model = next((event.robot.name for event in events if isinstance(event, Ready)), self.model)
        out = self.session.data_to_send()
        if out:
            self.transport.write(out)

    def turn_until(self, done, timeout=10.0):
        deadline = time.monotonic() + timeout
        while not done():
            assert time.monotonic() < deadline, "timed out"
            self.turn()

    @property
    def x(self):
        return self.states[-1].x if self.states else 0.0

    def drive(self, v, to_x):
        self.turn_until(lambda: self.session.state is SessionState.READY)
        self.session.enable(True)
        self.motion = Velocity(v, 0.0)
        self.turn_until(lambda: self.x > to_x)

    def leave(self):
        self.session.close(time.monotonic())
        self.transport.write(self.session.data_to_send())
        self.transport.close()


def truth_of(path):
    header, *lines = path.read_text().splitlines()
    assert header == ",".join(TRUTH_COLUMNS)
    return [dict(zip(TRUTH_COLUMNS, map(float, line.split(",")), strict=True)) for line in lines]


def wait_for_standstill(truth):
    wait_for(lambda: truth.read_text().splitlines()[-1].split(",")[5] == "0.00000")


def test_drive_over_tcp_and_leave(mock, tmp_path):
    truth = tmp_path / "made" / "truth.csv"
    process, endpoint = mock("--truth", str(truth))
    client = Client(open_transport(endpoint))
    client.drive(0.3, to_x=0.03)
    with closing(open_transport(endpoint)) as second, pytest.raises(NoRobot, match="one client at a time"):
        second.read(2.0)
    client.leave()
    wait_for_standstill(truth)
    code, report, _ = process.stop()
    assert code == 0
    assert report["connections"] == 1
    assert report["bytes_in"] == client.transport.bytes_out
    assert report["bytes_out"] == client.bytes_in
    assert report["unknown_commands"] == report["bad_arguments"] == report["bad_checksums"] == 0
    assert not report["touched"]
    lines = truth_of(truth)
    assert lines[-1]["x"] == pytest.approx(report["pose"]["x"], abs=1e-5)
    assert lines[-1]["x"] > 0.03
    assert lines[-1]["v"] == 0.0
    assert [round(line["t_s"] * 100) for line in lines] == list(range(1, len(lines) + 1))
    steps_ns = np.diff([line["clock_ns"] for line in lines])
    assert np.abs(steps_ns - 10_000_000).max() <= 1
    wall_s = (lines[-1]["t_ns"] - lines[0]["t_ns"]) * 1e-9
    assert wall_s == pytest.approx(lines[-1]["t_s"] - lines[0]["t_s"], abs=0.05)
    assert abs(lines[-1]["t_ns"] * 1e-9 - time.time()) < 10


def test_a_client_that_vanishes_can_come_back_to_the_chosen_base_and_a_kill_leaves_whole_lines(
    mock, tmp_path
):
    truth = tmp_path / "truth.csv"
    options = ["--fault", "mute@0.2", "--model", "p3dx", "--course", "parking", "--truth", str(truth)]
    process, endpoint = mock(*options)
    client = Client(open_transport(endpoint))
    client.turn_until(lambda: client.states)
    reset(client.transport._socket)
    with closing(open_transport(endpoint)) as line:
        again = Client(line)
        again.turn_until(lambda: again.states)
        assert again.model == "p3dx"
        again.session.enable(True)
        again.turn_until(lambda: again.session.state is SessionState.LOST)
    process.send_signal(signal.SIGKILL)
    process.wait(5.0)
    assert truth.read_bytes().endswith(b"\n")
    assert truth_of(truth)[-1]["v"] == 0.0


def test_client_that_comes_before_the_end_of_the_last_one_is_reported_is_served():
    server = Server("127.0.0.1", 0, Pioneer("p3at-sh").firmware)
    with closing(server), ExitStack() as clients:
        for _ in range(2):
            line = clients.enter_context(socket.create_connection((server.host, server.port), 5.0))
            server._accept()
            reset(line)
    assert server.connections == 2


def reset(line):
    """End a TCP connection as a crash does."""
    line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    line.close()


@pytest.mark.parametrize("options", [[], ["--ros2", "--model", "turtlebot4"]])
def test_port_in_use_is_one_line_that_leaves_no_truth_and_keeps_that_of_before(options, tmp_path, capsys):
    before, new = tmp_path / "before.csv", tmp_path / "new.csv"
    before.write_text("mine")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        command = ["mock", *options, "--listen", f"127.0.0.1:{taken.getsockname()[1]}", "--truth"]
        assert run([*command, str(before), "--overwrite"]) == 2
        assert run([*command, str(new)]) == 2
    assert (before.read_text(), new.exists()) == ("mine", False)
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_running_mock_takes_faults_from_its_input_and_answers_when_they_began(mock, tmp_path):
    truth = tmp_path / "truth.csv"
    process, _ = mock("--fault", "-", "--truth", str(truth), reads_lines=True)
    began_ns = time.monotonic_ns()
    moment_ns = process.tell("explode\nmute").t_ns
    # The beginning of a step, on the machine's monotonic clock, as the rows of the truth are.
    assert began_ns - 10_000_000 <= moment_ns <= time.monotonic_ns()
    rows = wait_for(lambda: truth_of(truth))
    assert abs((moment_ns - rows[0]["clock_ns"] + 5e6) % 10e6 - 5e6) < 1e3
    log = (tmp_path / "mock.log").read_text().splitlines()
    assert "expected NAME" in log[1]
    assert log[2].endswith(" mute")
    code, report, _ = process.stop()
    assert (code, report["connections"]) == (0, 0)


def test_mock_serves_where_no_fault_can_come_from_its_input(mock):
    process, endpoint = mock("--fault", "-")  # its input is /dev/null
    client = Client(open_transport(endpoint))
    client.turn_until(lambda: client.session.state is SessionState.READY)
    client.leave()
    process.send_signal(signal.SIGINT)
    code, report, _ = process.wait(10.0)
    assert (code, report["connections"]) == (0, 1)
