"""Recordings that end early: the driver killed, the disk full. The drive goes on; the file stays readable."""

import json
import resource
import subprocess
import sys
import time

import pytest
from kit.bridge_bench import Rig, wait_for
from kit.paths import DATA
from mcap.reader import make_reader

from rover_ncp import cli
from rover_ncp.recording.recording import read_recording
from sim.live.processes import compile_driver

COURSE = DATA / "prompt_course.yaml"
LOST_S = 0.5
SMALL_BYTES = 40_000


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


@pytest.fixture
def start(rig):
    """Starts a deploy that records; no file it writes may grow beyond ``limit`` bytes."""
    processes = []
    compile_driver()

    def start(record, limit=None, *options):
        def small():
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        arguments = ["--robot", rig.locator, "--course", str(COURSE), "--record", str(record), *options]
        process = subprocess.Popen(
            [sys.executable, "-m", "rover_ncp", "deploy", *arguments, "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            preexec_fn=small,  # noqa: PLW1509  # it calls setrlimit and nothing else
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        with process:
            process.kill()


def messages_of(path):
    """Read with the mcap library's own reader, by its index."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.attachment_count == 3
        return list(reader.iter_messages())


# Records as a drive does, without a rover: a message each 10 ms.
RECORDS = """
import sys, time
from pathlib import Path
from deploy.recorder import Recorder
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.messages import text
recorder = Recorder(Path(sys.argv[1]))
recorder.open({"policy.yaml": b"a", "course.yaml": b"b", "deploy.yaml": b"c"})
while True:
    now_ns = time.time_ns()
    recorder.put(Recorded("rover/status", "std_msgs/msg/String", text("x" * 500), now_ns, now_ns))
    time.sleep(0.01)
"""


def test_a_killed_process_loses_half_a_second_and_its_recording_is_made_whole(tmp_path, capsys):
    record = tmp_path / "run.mcap"
    process = subprocess.Popen([sys.executable, "-c", RECORDS, str(record)])
    wait_for(lambda: record.exists() and record.stat().st_size > 30_000, 60.0)
    killed_ns = time.time_ns()
    process.kill()
    process.wait()
    before = read_recording(record)
    assert not before.complete
    assert killed_ns - before.messages[-1].log_ns < LOST_S * 1e9
    assert cli.run(["recover", str(record), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["was_complete"], said["messages"]) == (False, len(before.messages))
    assert len(messages_of(record)) == len(before.messages)
    assert [message.data for message in read_recording(record).messages] == [
        message.data for message in before.messages
    ]
    content = record.read_bytes()
    assert cli.run(["recover", str(record)]) == 0  # again: nothing to do
    assert "was whole already" in capsys.readouterr().out
    assert record.read_bytes() == content


@pytest.mark.long
def test_no_recording_is_overwritten_not_even_while_it_is_written(rig, start, tmp_path, capsys):
    record = tmp_path / "run.mcap"
    process = start(record, None, "--duration", "4")
    wait_for(lambda: record.exists() and record.stat().st_size > 30_000, 20.0)
    again = ["deploy", "--robot", rig.locator, "--course", str(COURSE), "--record", str(record)]
    assert cli.run(again) == 2
    assert f"{record}: exists already" in capsys.readouterr().err
    assert cli.run(["recover", str(record)]) == 2
    assert f"{record}: another process is writing it" in capsys.readouterr().err
    result = json.loads(process.communicate(timeout=30)[0])
    assert (result["ticks"], result["recording_failure"]) == (40, None)
    assert cli.run(["replay", str(record)]) == 0
    content = record.read_bytes()
    assert cli.run(["recover", str(record), "--out", str(record.with_name("whole.mcap"))]) == 0
    assert cli.run(["recover", str(record), "--out", str(record.with_name("whole.mcap"))]) == 2
    assert cli.run(again) == 2
    assert record.read_bytes() == content


@pytest.mark.long
def test_a_full_disk_does_not_stop_the_drive_and_is_reported(start, tmp_path):
    record = tmp_path / "run.mcap"
    process = start(record, SMALL_BYTES, "--duration", "5")
    out, _ = process.communicate(timeout=30)
    result = json.loads(out)
    assert process.returncode == 1  # not parked within 5 s; nothing worse
    assert result["ticks"] == 50
    assert "File too large" in result["recording_failure"]
    assert result["recording_dropped"] > 0
    assert record.stat().st_size <= SMALL_BYTES
    assert cli.run(["recover", str(record), "--out", str(tmp_path / "whole.mcap")]) == 0
    assert {message[1].topic for message in messages_of(tmp_path / "whole.mcap")} >= {"odom", "cmd_vel"}
