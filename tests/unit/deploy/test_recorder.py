import errno
import json
import threading
import time

import numpy as np
import pytest
from kit.virtual_drive import VirtualDrive

from deploy import app
from deploy.recorder import BEHIND, Recorder
from deploy.tag.view import View
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.console import Output
from rover_ncp.core.errors import FileError
from rover_ncp.recording.recording import Recorded, RecordingWriter, read_recording
from rover_ncp.wire.key_table import TAG_VIEW, spec
from rover_ncp.wire.messages import read_text, text
from sim.park.live import wait_for

BLACK = np.zeros((48, 64), np.uint8)


def note(words, now_ns=None):
    now = now_ns or time.time_ns()
    return Recorded("a", "std_msgs/msg/String", text(words), now, now)


@pytest.fixture
def recorder(tmp_path):
    """One that writes run.mcap and is open, in a drive that has begun."""
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.open({"policy.yaml": b"x"})
    recorder.begin()
    return recorder


def test_every_message_is_written_in_order_also_those_before_the_file_is_open(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    for number in range(500):
        recorder.put(note(str(number)))
        if number == 100:
            recorder.open({"policy.yaml": b"x"})
    recorder.begin()
    recorder.close()
    recording = read_recording(tmp_path / "run.mcap")
    assert recording.complete
    assert [read_text(message.data) for message in recording.messages] == [str(n) for n in range(500)]
    assert recording.attachment("policy.yaml") == b"x"
    assert (recorder.dropped, recorder.failure) == (0, "")


def test_a_recorder_that_is_behind_drops_pictures_and_nothing_else(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap")
    picture = Recorded(TAG_VIEW, spec(TAG_VIEW).type, View(BLACK, [], "", 1).messages()[TAG_VIEW], 1, 1)
    for number in range(BEHIND):
        recorder.put(picture if number == 0 else note(str(number)))
    for message in (picture, note("late")):
        recorder.put(message)
    recorder.open({})
    recorder.begin()
    recorder.close()
    recording = read_recording(tmp_path / "run.mcap")
    assert (len(recording.topic(TAG_VIEW)), len(recording.topic("a")), recorder.dropped) == (1, BEHIND, 1)


def test_a_disk_that_hangs_never_blocks_the_caller(tmp_path, monkeypatch):
    hang = threading.Event()
    monkeypatch.setattr("deploy.recorder.QUEUE_LENGTH", 50)
    monkeypatch.setattr(RecordingWriter, "write", lambda self, message: hang.wait(30))
    recorder = Recorder(tmp_path / "run.mcap")
    recorder.open({})
    for number in range(200):
        recorder.put(note(str(number)))
    assert recorder.dropped >= 149
    hang.set()
    recorder.close()


def test_message_that_no_recording_can_hold_is_dropped_and_recording_goes_on(recorder, caplog):
    message = Recorded("a", "nav_msgs/msg/Odometry", b"", 1, 1)
    for each in (note("one"), message, message, note("three")):
        recorder.put(each)
    recorder.close()
    assert (recorder.failure, recorder.dropped) == ("", 2)
    assert caplog.text.count("a has two types") == 1
    found = read_recording(recorder.path)
    assert (found.complete, [read_text(each.data) for each in found.messages]) == (True, ["one", "three"])


def test_full_disk_ends_the_recording_and_not_the_drive(tmp_path, monkeypatch, capsys):
    virtual, recorder = VirtualDrive(), Recorder(tmp_path / "run.mcap")
    virtual.use_in(app, monkeypatch)
    write, receive = RecordingWriter.write, virtual.bridge.command

    def fill(writer, message):
        if len(virtual.link.sent) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(writer, message)

    def command(*message):
        receive(*message)
        wait_for(lambda: len(virtual.link.sent) <= 6 or recorder.failure, 20.0)

    monkeypatch.setattr(RecordingWriter, "write", fill)
    virtual.bridge.command = command
    drive = {"policy": virtual.policy, "course": virtual.course, "config": virtual.config}
    assert app.run(BridgeAddress("virtual"), Output(as_json=True), recorder=recorder, **drive) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["stopped_by"], result["ticks"]) == (None, virtual.course.ticks)
    assert "No space left on device" in result["recording_failure"]
    assert result["recording_dropped"] > 50
    assert not read_recording(recorder.path).complete


def test_a_recording_replaces_no_file_and_a_folder_gets_one_named_by_the_time(tmp_path, recorder):
    recorder.close()
    before = recorder.path.read_bytes()
    with pytest.raises(FileError, match="exists already; choose another name"):
        Recorder(recorder.path)
    named = Recorder(tmp_path)
    named.open({})
    named.begin()
    named.close()
    assert recorder.path.read_bytes() == before
    (written,) = set(tmp_path.glob("*.mcap")) - {recorder.path}
    assert named.fields["recording"] == str(written)
    assert time.strptime(written.stem, "%Y-%m-%d_%H-%M-%S").tm_year >= 2024


def test_log_times_are_free_of_settings_of_the_wall_clock(recorder, monkeypatch):
    by_s, wall_ns, offset_ns = -3600, time.time_ns, 0
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns() + offset_ns)
    dated = time.time_ns() - 10**10
    recorder.put(note("one"))
    offset_ns = by_s * 10**9
    recorder.put(note("two"))
    recorder.put(note("dated at the start", dated))
    recorder.close()
    one, two, path = read_recording(recorder.path).messages
    assert 0 <= two.log_ns - one.log_ns < 10**9
    assert two.publish_ns - one.publish_ns == pytest.approx(by_s * 1e9, abs=1e9)
    assert path.log_ns == dated
