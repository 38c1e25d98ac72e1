import time

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.recording.mcap_format import MAGIC, RECORD_LIMIT
from rover_ncp.recording.recording import (
    Recorded,
    RecordingWriter,
    read_recording,
    recover,
    rewrite,
)
from rover_ncp.wire.messages import odometry, pose_stamped, text

T0 = 1_700_000_000_000_000_000
POLICY = b"format: 1\n" * 50


def odom(number):
    stamp = T0 + number * 100_000_000
    data = odometry(Pose(0.01 * number, 0.5, 0.1), Velocity(0.1, 0.0), stamp)
    return Recorded("odom", "nav_msgs/msg/Odometry", data, stamp + 1_000_000, stamp, number)


def status(number):
    stamp, data = T0 + number * 100_000_000, text(f"{number}")
    return Recorded("rover/status", "std_msgs/msg/String", data, stamp + 2_000_000, stamp, number)


def write(path, messages):
    with RecordingWriter(path) as writer:
        for message in messages:
            writer.write(message)
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("new") / "new" / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.attach("policy.yaml", POLICY)
        writer.describe("run", {"driver": "ab"})
        for number in range(40):
            writer.write(odom(number))
            writer.write(status(number))
            if number % 10 == 9:
                writer.flush()
    return path


def test_written_messages_are_read(written):
    found = read_recording(written)
    assert found.complete
    assert (found.attachments, found.metadata["run"]) == ({"policy.yaml": POLICY}, {"driver": "ab"})
    assert found.topic("odom") == [odom(number) for number in range(40)]
    assert found.topic("rover/status") == [status(number) for number in range(40)]
    with pytest.raises(FileError, match=r"no attachment course.yaml \(it has: policy.yaml\)"):
        found.attachment("course.yaml")


def test_other_readers_understand_it(written):
    with written.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 80
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert [attachment.data for attachment in reader.iter_attachments()] == [POLICY]
    with AnyReader([written]) as reader:
        poses = [
            reader.deserialize(raw, connection.msgtype).pose.pose.position.x
            for connection, _, raw in reader.messages()
            if connection.topic == "odom"
        ]
    assert poses == [0.01 * number for number in range(40)]


def test_cut_off_anywhere_it_gives_a_prefix_of_whole_messages(written, tmp_path):
    content, whole = written.read_bytes(), read_recording(written)
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in range(0, len(content), 97):
        cut.write_bytes(content[:size])
        if size < 40:
            with pytest.raises(FileError, match=r"empty|before its first record"):
                read_recording(cut)
            continue
        part = read_recording(cut)
        assert not part.complete
        assert part.messages == whole.messages[: len(part.messages)]
        assert set(part.attachments.values()) == {POLICY} or not (part.attachments or part.messages)
        counts.append(len(part.messages))
    assert counts == sorted(counts)
    assert {0, 20, 40, 60, 80} <= set(counts)


def test_a_damaged_file_is_read_up_to_the_damage(written, tmp_path, caplog):
    content, whole = written.read_bytes(), read_recording(written)
    damaged = tmp_path / "damaged.mcap"
    kept = set()
    for where in range(len(MAGIC) + 40, len(content), 53):
        damaged.write_bytes(content[:where] + bytes([content[where] ^ 0x10]) + content[where + 1 :])
        caplog.clear()
        part = read_recording(damaged)
        # Data with a checksum is never read wrong: topics and bytes are those that were written.
        assert {message.data for message in part.messages} <= {message.data for message in whole.messages}
        assert len(caplog.messages) == (not part.complete)
        assert all(str(damaged) in line and "\n" not in line for line in caplog.messages)
        kept.add(len(part.messages))
    assert kept >= {0, 20, 40, 60, 80}


@pytest.mark.parametrize("tail", [b"\0" * 100_000, MAGIC])
def test_garbage_at_the_end_costs_no_message_before_it(written, tmp_path, tail):
    content = written.read_bytes()
    content = content[: content.rindex(b"nav_msgs/msg/Odometry") - 40]  # the index is lost
    path = tmp_path / "tail.mcap"
    path.write_bytes(content + tail)
    assert read_recording(path).messages == read_recording(written).messages
    found = recover(path, path)
    assert (found.messages, bool(found.damage)) == (80, True)
    with path.open("rb") as file:  # viewers find the index at the end
        assert make_reader(file).get_summary().statistics.message_count == 80
    assert not recover(path, path).damage


def test_rewriting_makes_a_cut_off_file_whole_and_adds_a_topic_in_order(written, tmp_path):
    cut = tmp_path / "cut.mcap"
    content = written.read_bytes()
    cut.write_bytes(content[: len(content) * 2 // 3])
    source = read_recording(cut)
    data = pose_stamped(Pose(0.0, 0.0, 0.0), T0, "course")
    times = [T0 + 10_000_000 * number for number in range(30)]
    truth = [Recorded("truth/pose", "geometry_msgs/msg/PoseStamped", data, ns, ns) for ns in times]
    before = time.time_ns()
    rewrite(source, cut, truth)
    copy = read_recording(cut)
    assert (source.complete, copy.complete) == (False, True)
    assert (copy.attachments, copy.metadata) == (source.attachments, source.metadata)
    assert (copy.topic("truth/pose"), copy.topic("odom")) == (truth, source.topic("odom"))
    times = [message.log_ns for message in copy.messages]
    assert times == sorted(times)
    assert times[-1] < before
    with cut.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == len(copy.messages)


def chunked(path, *chunks):
    """Write a recording of chunks: the size that each names, its compression, and its packed bytes."""
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(library="rover-ncp")
        channel = writer.register_channel("a", "", 0)
        writer.add_message(channel, 1, b"first", 1)
        for size, compression, data in chunks:
            builder = RecordBuilder()
            Chunk(compression, data, 0, 0, 0, size).write(builder)
            file.write(builder.end())
    return path


@pytest.mark.parametrize(("compression", "pack"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress)])
def test_unpacked_size_has_a_limit_that_is_named(tmp_path, compression, pack):
    bomb, path = pack(bytes(RECORD_LIMIT + 1)), tmp_path / "bomb.mcap"
    with pytest.raises(FileError, match=rf"bomb\.mcap: .*at most {RECORD_LIMIT} bytes are read"):
        read_recording(chunked(path, (RECORD_LIMIT + 1, compression, bomb)))
    part = read_recording(chunked(path, (1000, compression, bomb)))  # it names another size
    assert [message.data for message in part.messages] == [b"first"]
    assert "size of a chunk differs" in part.damage
