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


def test_every_message_is_written_in_order_also_those_before_the_file_is_open(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    for number in range(500):
        recorder.put(note(str(number)))
        if number == 100:
            recorder.open({"policy.yaml": b"x"})
    recorder.close()
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert [read_text(message.data) for message in recording.messages] == [str(n) for n in range(500)]
    assert recording.attachment("policy.yaml") == b"x"
    assert (recorder.written, recorder.dropped, recorder.failure) == (500, 0, "")


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


def test_a_path_that_cannot_be_written_is_reported_at_once(tmp_path):
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
