"""An interruption of ``park`` ends all of its processes, also when a second one comes while they end."""

import json
import signal

import psutil

from rover_ncp.cli import run
from sim.live.live_run import LiveRun
from sim.live.processes import Process


def test_second_interruption_does_not_keep_processes_from_being_ended(tmp_path, capsys, monkeypatch):
    stop = Process.stop

    def interrupted_stop(process):
        if process.command == "bridge":  # the mock ends after it
            signal.raise_signal(signal.SIGINT)
        return stop(process)

    def interrupted_deploy(live, *arguments):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Process, "stop", interrupted_stop)
    monkeypatch.setattr(LiveRun, "deploy", interrupted_deploy)
    before = set(psutil.Process().children(recursive=True))
    assert run(["park", "--policy", "course", "--out", str(tmp_path / "out"), "--json"]) == 130
    assert json.loads(capsys.readouterr().out)["kind"] == "Interrupted"
    assert set(psutil.Process().children(recursive=True)) <= before
