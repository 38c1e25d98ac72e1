"""An interruption of a live trial ends its processes and its localisation, whenever it comes."""

import json
import signal

import psutil
import pytest

from rover_ncp.cli import run
from sim.live import trials
from sim.live.peers import StartPosePublisher
from sim.live.processes import Process

ARGUMENTS = ["eval", "course", "--live", "1", "--randomize", "none", "--json"]


def assert_interrupted(tmp_path, capsys):
    before = set(psutil.Process().children(recursive=True))
    assert run([*ARGUMENTS, "--out", str(tmp_path / "out")]) == 130
    assert json.loads(capsys.readouterr().out)["kind"] == "Interrupted"
    assert set(psutil.Process().children(recursive=True)) <= before


def test_interruption_while_the_localisation_starts_ends_it(tmp_path, capsys, monkeypatch):
    closed = []

    class Interrupted(StartPosePublisher):
        def start(self):
            super().start()
            signal.raise_signal(signal.SIGINT)
            return self

        def close(self):
            super().close()
            closed.append(self)

    monkeypatch.setattr(trials, "StartPosePublisher", Interrupted)
    assert_interrupted(tmp_path, capsys)
    # Else its session keeps a thread, and Python waits for that thread for ever.
    assert len(closed) == 1


@pytest.mark.parametrize("command", ["mock", "bridge"])
def test_second_interruption_does_not_keep_processes_from_being_ended(tmp_path, capsys, monkeypatch, command):
    stop = Process.stop

    def interrupted_stop(process):
        if process.command == command:
            signal.raise_signal(signal.SIGINT)
        return stop(process)

    class Interrupted(StartPosePublisher):
        def __init__(self, robot, pose):
            signal.raise_signal(signal.SIGINT)
            super().__init__(robot, pose)

    monkeypatch.setattr(Process, "stop", interrupted_stop)
    monkeypatch.setattr(trials, "StartPosePublisher", Interrupted)
    assert_interrupted(tmp_path, capsys)
