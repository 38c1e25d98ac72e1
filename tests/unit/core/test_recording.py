import io
import struct
import time

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from rover_ncp.core.errors import FileError
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.core.messages import odometry, pose_stamped, text
from rover_ncp.core.recording import Recorded, RecordingWriter, header_stamp_ns, read_recording, rewrite

T0 = 1_700_000_000_000_000_000
POLICY = b"format: 1\n" * 50


def odom(number):
    stamp = T0 + number * 100_000_000
    data = odometry(Pose(0.01 * number, 0.5, 0.1), Velocity(0.1, 0.0), stamp)
    return Recorded("odom", "nav_msgs/msg/Odometry", data, stamp + 1_000_000, stamp, number)


def status(number):
    stamp = T0 + number * 100_000_000
    return Recorded(
        "rover/status", "std_msgs/msg/String", text(f"{number}"), stamp + 2_000_000, stamp, number
    )


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "new" / "run.mcap"
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
    recording = read_recording(written)
    assert recording.complete
    assert recording.attachment("policy.yaml") == POLICY
    assert recording.metadata["run"] == {"driver": "ab"}
    assert recording.topic("odom") == [odom(number) for number in range(40)]
    assert recording.topic("rover/status") == [status(number) for number in range(40)]
    with pytest.raises(FileError, match=r"no attachment course.yaml \(it has: policy.yaml\)"):
        recording.attachment("course.yaml")


def test_recovery_keeps_messages_of_other_software_as_bytes(tmp_path):
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1", library="another")
        poses = writer.register_schema("lab/Pose", "jsonschema", b'{"type": "object"}')
        told = [
            (writer.register_channel("/pose", "json", poses, {"lab": "7"}), b'{"x": 1}'),
            (writer.register_channel("/raw", "", 0, {}), b"\0\1\2"),
            (writer.register_channel("/pose", "cbor", 0, {}), b"\xa0"),  # a second one on the same topic
        ]
        for number, (channel, data) in enumerate(told * 3):
            writer.add_message(channel, T0 + number, data, T0 + number, number)
        writer.finish()
    whole = path.read_bytes()
    with path.open("rb") as file:
        expected = [
            (schema, channel.topic, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
        ]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: whole.rindex(b"lab/Pose") - 40])  # the index and the footer are lost
    assert not read_recording(cut).complete
    rewrite(read_recording(cut), cut)
    with cut.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros1"
        found = list(reader.iter_messages())
    assert [(s and (s.name, s.encoding, s.data), c.topic, m.data) for s, c, m in found] == [
        (s and (s.name, s.encoding, s.data), topic, data) for s, topic, data in expected
    ]
    assert [channel.message_encoding for _, channel, _ in found] == ["json", "", "cbor"] * 3
    assert found[0][1].metadata == {"lab": "7"}


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


def test_the_time_of_sending_is_the_headers_stamp():
    assert header_stamp_ns("nav_msgs/msg/Odometry", odom(7).data) == T0 + 700_000_000
    big_endian = b"\x00\x00\x00\x00" + struct.pack(">iI", 5, 6) + bytes(64)
    assert header_stamp_ns("geometry_msgs/msg/TwistStamped", big_endian) == 5_000_000_006
    assert header_stamp_ns("std_msgs/msg/String", text("hello, world")) is None
    assert header_stamp_ns("nav_msgs/msg/Odometry", b"\x00\x01\x00\x00short") is None
    assert header_stamp_ns("nav_msgs/msg/Odometry", b"\xff" * 40) is None


def test_a_topic_has_one_type(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.write(odom(0))
        with pytest.raises(ValueError, match="odom holds nav_msgs/msg/Odometry"):
            writer.write(Recorded("odom", "std_msgs/msg/String", text(""), T0, T0))


def test_cut_off_anywhere_it_gives_a_prefix_of_whole_messages(written, tmp_path):
    content, whole = written.read_bytes(), read_recording(written)
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in range(0, len(content), 97):
        cut.write_bytes(content[:size])
        try:
            part = read_recording(cut)
        except FileError as error:
            assert size < 40
            assert "empty" in str(error) or "before its first record" in str(error)
            continue
        assert not part.complete
        assert part.messages == whole.messages[: len(part.messages)]
        assert set(part.attachments.values()) <= {POLICY}
        if part.messages:
            assert part.attachment("policy.yaml") == POLICY
        counts.append(len(part.messages))
    assert counts == sorted(counts)
    assert {0, 20, 40, 60, 80} <= set(counts)


def test_flushed_messages_are_on_the_disk_before_the_end(tmp_path):
    writer = RecordingWriter(tmp_path / "a.mcap")
    writer.attach("policy.yaml", POLICY)
    for number in range(5):
        writer.write(odom(number))
    writer.flush()
    recording = read_recording(tmp_path / "a.mcap")
    assert len(recording.messages) == 5
    assert recording.attachment("policy.yaml") == POLICY
    writer.abandon()


def test_a_damaged_file_is_refused_with_its_name_or_read_to_the_damage(written, tmp_path):
    content, whole = written.read_bytes(), read_recording(written)
    damaged = tmp_path / "damaged.mcap"
    refused = 0
    for where in range(0, len(content), 53):
        damaged.write_bytes(content[:where] + bytes([content[where] ^ 0x10]) + content[where + 1 :])
        try:
            part = read_recording(damaged)
        except FileError as error:
            assert "damaged.mcap" in str(error)
            refused += 1
        else:
            # Data with a checksum is never read wrong: topics and bytes are those that were written.
            assert {message.data for message in part.messages} <= {message.data for message in whole.messages}
    assert refused > 20


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"hello, this is text", "not an MCAP recording"),
        (b"\x89MCAP0\r\n", "cut off before its first record"),
        (b"\x89MCAP0\r\n" + b"\x01" + struct.pack("<Q", 1 << 60), "damaged before byte"),
        (b"\x89MCAP0\r\n" + b"\x01" + struct.pack("<Q", 4) + b"\xff\xff\xff\x7f", "cut off"),
    ],
)
def test_file_that_is_no_recording_is_a_one_line_error(tmp_path, content, message):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(FileError, match="cannot be read"):
        read_recording(tmp_path / "nothing.mcap")


def test_a_recording_of_others_is_read_too(tmp_path):
    buffer = io.BytesIO()
    writer = Writer(buffer, use_chunking=False)
    writer.start()
    channel = writer.register_channel("a", "json", 0)
    writer.add_message(channel, 5, b"{}", 6)
    writer.finish()
    path = tmp_path / "other.mcap"
    path.write_bytes(buffer.getvalue())
    assert read_recording(path).messages == (Recorded("a", "", b"{}", 5, 6),)


def test_rewriting_makes_a_cut_off_file_whole_and_adds_a_topic_in_order(written, tmp_path):
    cut = tmp_path / "cut.mcap"
    content = written.read_bytes()
    cut.write_bytes(content[: len(content) * 2 // 3])
    source = read_recording(cut)
    truth = [
        Recorded(
            "truth/pose",
            "geometry_msgs/msg/PoseStamped",
            pose_stamped(Pose(0.0, 0.0, 0.0), T0 + 10_000_000 * number, "course"),
            T0 + 10_000_000 * number,
            T0 + 10_000_000 * number,
        )
        for number in range(30)
    ]
    before = time.time_ns()
    rewrite(source, cut, truth)
    copy = read_recording(cut)
    assert copy.complete
    assert not source.complete
    assert copy.attachments == source.attachments
    assert copy.metadata == source.metadata
    assert copy.topic("truth/pose") == truth
    assert copy.topic("odom") == source.topic("odom")
    times = [message.log_ns for message in copy.messages]
    assert times == sorted(times)
    assert max(times) < before
    with cut.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == len(copy.messages)
