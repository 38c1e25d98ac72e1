import signal
import subprocess
import sys
import threading
import time

import pytest

from deploy.recorder import Recorder
from rover_ncp.core.errors import FileError
from rover_ncp.core.messages import read_text, text
from rover_ncp.core.recording import Recorded, RecordingWriter, read_recording


def note(words, now_ns=None):
    now = now_ns or time.time_ns()
    return Recorded("a", "std_msgs/msg/String", text(words), now, now)


def test_everything_handed_over_is_written_in_order(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.open({"policy.yaml": b"x"})
    for number in range(500):
        recorder.put(note(str(number)))
    recorder.close()
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert [read_text(message.data) for message in recording.messages] == [str(n) for n in range(500)]
    assert recording.attachment("policy.yaml") == b"x"
    assert (recorder.written, recorder.dropped, recorder.failure) == (500, 0, "")


# Prints each stamp, and how long another thread that writes to the same disk has waited at most (ns).
WRITER = """
import sys, threading, time
from pathlib import Path
from deploy.recorder import Recorder
from rover_ncp.core.messages import text
from rover_ncp.core.recording import Recorded
late, woken = 0, time.monotonic_ns()
def late_now():
    return max(late, time.monotonic_ns() - woken - 10_000_000)
def witness():
    global late, woken
    with open(sys.argv[1] + ".witness", "wb", buffering=0) as file:
        while True:
            time.sleep(0.01)
            file.write(b"x")
            late = late_now()
            woken = time.monotonic_ns()
recorder = Recorder(Path(sys.argv[1]))
recorder.open({"policy.yaml": b"x" * 1000})
threading.Thread(target=witness, daemon=True).start()
while True:
    now = time.time_ns()
    recorder.put(Recorded("a", "std_msgs/msg/String", text(str(now)), now, now))
    print(now, late_now(), flush=True)
    time.sleep(0.01)
"""


def test_killed_at_any_moment_it_loses_half_a_second_at_most(tmp_path):
    lost = []
    for run_s in (0.95, 1.2):  # at different points between two flushes
        path = tmp_path / f"{run_s}.mcap"
        put = []
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
        ) as child:
            for line in child.stdout:
                put.append([*map(int, line.split())])
                if put[-1][0] - put[0][0] > run_s * 1e9:
                    break
            child.send_signal(signal.SIGKILL)
            put += [[*map(int, line.split())] for line in child.stdout]
        recording = read_recording(path)
        assert not recording.complete
        assert recording.attachment("policy.yaml") == b"x" * 1000
        on_disk = len(recording.messages)
        assert [message.log_ns for message in recording.messages] == [stamp for stamp, _ in put[:on_disk]]
        lost.append((put[-1][0] - put[max(on_disk - 1, 0)][0]) / 1e9)
        # No thread can write while the machine or the disk keeps it waiting.
        assert lost[-1] <= 0.5 + put[-1][1] / 1e9
    assert max(lost) > 0.05  # a kill does cost something: otherwise this test looks at the wrong thing


LIMITED = """
import resource, sys, time
from pathlib import Path
from deploy.recorder import Recorder
from rover_ncp.core.messages import text
from rover_ncp.core.recording import Recorded
import random
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
recorder = Recorder(Path(sys.argv[1]))
recorder.open({"policy.yaml": b"x"})
noise = random.Random(0)
longest = 0.0
for number in range(200):
    began = time.monotonic()
    now = time.time_ns()
    recorder.put(Recorded("a", "std_msgs/msg/String", text(noise.randbytes(1000).hex()), now, now))
    longest = max(longest, time.monotonic() - began)
    time.sleep(0.005)
recorder.close()
assert "File too large" in recorder.failure, recorder.failure
assert recorder.dropped > 0
print(longest)
"""


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path):
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-W", "error", "-c", LIMITED, str(path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert path.stat().st_size <= 20_000
    recording = read_recording(path)
    assert not recording.complete
    assert recording.attachment("policy.yaml") == b"x"


def test_a_disk_that_hangs_never_blocks_the_caller(tmp_path, monkeypatch):
    hang = threading.Event()
    monkeypatch.setattr("deploy.recorder.QUEUE_LENGTH", 50)
    monkeypatch.setattr(RecordingWriter, "write", lambda self, message: hang.wait(30))
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.open({})
    began = time.monotonic()
    for number in range(200):
        recorder.put(note(str(number)))
    assert time.monotonic() - began < 0.5
    assert recorder.dropped >= 149
    hang.set()
    recorder.close()


def test_any_failure_of_the_thread_is_reported(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.open({})
    recorder.put(note("one"))
    recorder.put(Recorded("a", "nav_msgs/msg/Odometry", b"", 1, 1))  # another type on the same topic
    recorder.close()
    assert "a holds std_msgs/msg/String" in recorder.failure
    assert recorder.dropped == 0
    assert recorder.written == 1


def test_a_place_that_cannot_be_written_is_said_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="cannot be written"):
        Recorder(tmp_path / "file" / "run.mcap")
    with pytest.raises(FileError, match=f"{tmp_path}: cannot be written"):
        Recorder(tmp_path)


def test_overwriting_does_not_damage_what_another_writer_still_writes(tmp_path):
    path = tmp_path / "run.mcap"
    first = Recorder(path)
    first.open({})
    first.put(note("first"))
    second = Recorder(path, overwrite=True)
    second.open({})
    second.put(note("second"))
    first.close()
    second.close()
    assert [read_text(message.data) for message in read_recording(path).messages] == ["second"]
    assert read_recording(path).complete
