"""A recording whose process is killed: what was recorded stays readable."""

import subprocess
import sys

import pytest
from kit.bridge_bench import wait_for
from mcap.reader import make_reader

from rover_ncp import cli
from rover_ncp.recording.recording import read_recording

LOST_S = 0.5
# Records as a drive does, without a rover, until it is killed.
RECORDS = """
import os, sys, time
from pathlib import Path
from deploy.recorder import Recorder
from rover_ncp.recording.recording import Recorded
from rover_ncp.wire.messages import text
recorder = Recorder(Path(sys.argv[1]))
recorder.open({"policy.yaml": b"a", "course.yaml": b"b", "deploy.yaml": b"c"})
recorder.begin()
while True:
    now_ns = time.time_ns()
    recorder.put(Recorded("rover/status", "std_msgs/msg/String", text(os.urandom(500).hex()), now_ns, now_ns))
    print(now_ns, flush=True)
    time.sleep(0.01)
"""


@pytest.fixture
def record(tmp_path):
    """A process that records, and the file that it writes."""
    command = [sys.executable, "-c", RECORDS, str(tmp_path / "run.mcap")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process, tmp_path / "run.mcap"
        process.kill()


def messages_of(path):
    """Read with the mcap library's own reader, by its index."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.attachment_count == 3
        return list(reader.iter_messages())


def test_a_killed_process_loses_half_a_second_and_its_recording_is_made_whole(record, run_json, capsys):
    process, path = record
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
