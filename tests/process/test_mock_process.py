"""The mock as a process, on real TCP: clients that vanish, faults from its input, its end."""

import os
import signal
import socket
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from kit.paths import ROOT
from kit.pioneer_bench import Pioneer
from kit.true_motion import moving

from bridge.pioneer.framing import Command, Decoder, encode_command, encode_frame
from bridge.pioneer.packets import Kind, decode_names
from bridge.pioneer.transport import open_transport
from rover_ncp.cli import run
from rover_ncp.core.errors import UsageError
from sim.mock.options import MockOptions
from sim.mock.ros2_server import free_port
from sim.mock.run import run_mock
from sim.mock.server import Server
from sim.park.live import Process, wait_for
from sim.park.truth import TruthReader

CAMERA, TAGS = (ROOT / "docs" / "examples" / name for name in ("camera.yaml", "tags.yaml"))


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


def test_client_that_comes_before_the_end_of_the_last_one_is_reported_is_served():
    server = Server("127.0.0.1", 0, Pioneer("p3at-sh").firmware)
    with closing(server), ExitStack() as clients:
        for _ in range(2):
            line = clients.enter_context(socket.create_connection((server.host, server.port), 5.0))
            server._accept()
            assert server._client.getpeername() == line.getsockname()
            reset(line)


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
    states = wait_for(TruthReader(truth).read)
    assert abs((moment_ns - states[0].clock_ns + 5e6) % 10e6 - 5e6) < 1e3
    log = (tmp_path / "mock.log").read_text().splitlines()
    assert "expected NAME" in log[1]
    assert log[2].endswith(" mute")
    assert process.stop().code == 0


def test_mock_serves_where_no_fault_can_come_from_its_input(mock):
    process, endpoint = mock("--fault", "-")  # its input is /dev/null
    with closing(open_transport(endpoint)) as line:
        greet(line)
    process.send_signal(signal.SIGINT)
    assert process.wait(10.0).code == 0


def test_no_client_connects_while_the_camera_starts(monkeypatch):
    """It would get no answer for as long as that takes, some seconds."""
    port = free_port("127.0.0.1")

    def camera(*_):
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), 1.0)
        raise UsageError("the camera starts")

    monkeypatch.setattr("sim.mock.run._camera", camera)
    options = MockOptions(listen=f"127.0.0.1:{port}", camera=Path("camera.yaml"), tags=Path("tags.yaml"))
    with pytest.raises(UsageError, match="the camera starts"):
        run_mock(options)


def test_camera_of_a_killed_mock_ends_and_leaves_its_port_to_the_next(mock):
    port = free_port("127.0.0.1")
    options = ["--camera", str(CAMERA), "--tags", str(TAGS), "--camera-listen", f"127.0.0.1:{port}"]
    process, _ = mock(*options)
    process.send_signal(signal.SIGKILL)
    process.wait(5.0)

    def is_free():
        try:
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            return False
        return True

    wait_for(is_free)
    process, _ = mock(*options)
    assert process.stop().code == 0


def camera_command():
    return ["mock", "--listen", "127.0.0.1:0", "--camera", str(CAMERA), "--tags", str(TAGS)]


@pytest.mark.parametrize("library", ["cv2", "apriltag"])
def test_camera_without_its_extra_is_one_line(library, monkeypatch, capsys):
    for name in ("sim.camera.server", "sim.camera.render", "deploy.tag.locate", "deploy.tag.detector"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in [each for each in sys.modules if each.startswith(f"{library}.")]:
        monkeypatch.delitem(sys.modules, name)  # it would be found without the library itself
    monkeypatch.setitem(sys.modules, library, None)
    assert run(camera_command()) == 2
    said = f"{library} is not installed: install rover-ncp with the extra tag, as rover-ncp[tag]"
    assert capsys.readouterr().err == f"rover-ncp: {said}\n"


def end_at_once(*_):
    os._exit(7)


def test_camera_whose_process_dies_at_its_start_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sim.camera.server._serve", end_at_once)
    assert run([*camera_command(), "--camera-listen", "127.0.0.1:0"]) == 2
    said = "its process ended with exit code 7 before it served a picture"
    assert capsys.readouterr().err == f"rover-ncp: camera 127.0.0.1:0: {said}\n"
