"""Recordings that end early: the process killed, the disk full. What was recorded stays readable."""

import json
import resource
import subprocess
import sys

import pytest
from kit.bridge_bench import wait_for
from mcap.reader import make_reader

from rover_ncp import cli
from rover_ncp.recording.recording import read_recording

LOST_S = 0.5
SMALL_BYTES = 40_000
# Records as a drive does, without a rover, until it is killed or its recording fails.
RECORDS = """
import json, os, sys, time
from pathlib import Path
from deploy.recorder import Recorder
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.messages import text
recorder = Recorder(Path(sys.argv[1]))
recorder.open({"policy.yaml": b"a", "course.yaml": b"b", "deploy.yaml": b"c"})
recorder.begin()
while not recorder.failure:
    now_ns = time.time_ns()
    recorder.put(Recorded("rover/status", "std_msgs/msg/String", text(os.urandom(500).hex()), now_ns, now_ns))
    print(now_ns, flush=True)
    time.sleep(0.01)
recorder.close()
print(json.dumps(recorder.fields))
"""


@pytest.fixture
def record(tmp_path):
    """Starts a process that records; no file it writes may grow beyond ``limit`` bytes."""
    processes = []

    def record(limit=resource.RLIM_INFINITY):
        process = subprocess.Popen(
            [sys.executable, "-c", RECORDS, str(tmp_path / "run.mcap")],
            stdout=subprocess.PIPE,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),  # noqa: PLW1509
            text=True,
        )
        processes.append(process)
        return process, tmp_path / "run.mcap"

    yield record
    for process in processes:
        with process:
            process.kill()


def messages_of(path):
    """Read with the mcap library's own reader, by its index."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.attachment_count == 3
        return list(reader.iter_messages())


def test_a_killed_process_loses_half_a_second_and_its_recording_is_made_whole(record, run_json, capsys):
    process, path = record()
    wait_for(lambda: path.exists() and path.stat().st_size > 30_000, 60.0)
    # No recording is overwritten or repaired while it is written.
    assert cli.run(["deploy", "--robot", "tcp/127.0.0.1:9", "--record", str(path), "--json"]) == 2
    assert f"{path}: exists already" in capsys.readouterr().err
    assert cli.run(["recover", str(path)]) == 2
    assert f"{path}: another process is writing it" in capsys.readouterr().err

    process.kill()
    put_ns = int(process.communicate()[0].split()[-1])  # a busy machine may have stalled the process since
    before = read_recording(path)
    assert not before.complete
    assert put_ns - before.messages[-1].log_ns < LOST_S * 1e9
    code, said = run_json(f"recover {path}")
    assert (code, said["was_complete"], said["messages"]) == (0, False, len(before.messages))
    assert len(messages_of(path)) == len(before.messages)
    assert [m.data for m in read_recording(path).messages] == [m.data for m in before.messages]


def test_a_full_disk_ends_the_recording_and_is_reported(record, tmp_path):
    process, path = record(SMALL_BYTES)
    result = json.loads(process.communicate(timeout=60)[0].splitlines()[-1])
    assert "File too large" in result["recording_failure"]
    assert path.stat().st_size <= SMALL_BYTES
    assert cli.run(["recover", str(path), "--out", str(tmp_path / "whole.mcap")]) == 0
    assert len(messages_of(tmp_path / "whole.mcap")) > 3
