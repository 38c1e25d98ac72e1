"""The codec, on bytes of third parties first: recorded clients, recorded robots, examples in manuals."""

from hypothesis import example, given
from hypothesis import strategies as st
from kit.arcos_captures import CAPTURES, VECTORS

from bridge.pioneer.framing import Decoder, Packet, checksum, encode_frame

CLEAN = [capture for capture in CAPTURES if not capture.name.startswith("fault")]
PACKETS = st.builds(Packet, st.integers(0, 255), st.binary(max_size=249))


def third_party_frames():
    """Every single frame that other people's software or manuals wrote."""
    for vector in VECTORS.values():
        texts = vector["hex"] if isinstance(vector["hex"], list) else [vector["hex"]]
        frames = [bytes.fromhex(text) for text in texts]
        yield from (frame for frame in frames if len(frame) == frame[2] + 3)
    for capture in CLEAN:
        for direction in ("c2r", "r2c"):
            stream = b"".join(data for _, data in capture.chunks(direction))
            while stream:
                size = stream[2] + 3
                yield stream[:size]
                stream = stream[size:]


FRAMES = sorted(set(third_party_frames()))


def test_every_third_party_frame_is_decoded_and_encodes_back_to_itself():
    assert len(FRAMES) > 500
    assert {len(frame) % 2 for frame in FRAMES} == {0, 1}
    for frame in FRAMES:
        decoder = Decoder()
        (packet,) = decoder.feed(frame)
        assert encode_frame(*packet) == frame
        assert (decoder.bad_checksums, decoder.skipped_bytes) == (0, 0)


def test_the_damaged_recording_loses_damaged_packets_only():
    """What the relay left whole arrives, although COUNTs were damaged, too."""
    capture = next(c for c in CAPTURES if c.name == "fault_aria_r2c_corrupt")
    decoder = Decoder()
    received = [packet for t, data in capture.chunks("r2c") for packet in decoder.feed(data, t)]
    whole = [packet for _, data in capture.chunks("r2c") for packet in Decoder().feed(data)]
    assert len(received) >= len(whole) > 100
    assert decoder.bad_checksums > 5


@given(st.lists(PACKETS, max_size=8), st.data())
def test_any_packets_in_any_pieces_arrive(packets, data):
    stream = b"".join(encode_frame(*packet) for packet in packets)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    decoder, received = Decoder(), []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        received += decoder.feed(stream[start:end])
    assert received == packets


@given(st.lists(st.binary(max_size=300), max_size=5), st.floats(0, 1))
@example([b"\xfa" * 300, b"\xfb\x03"], 0.1)
@example([b"\xfa\xfb\xfc" * 100], 0.1)
def test_garbage_gives_packets_with_good_checksums_or_is_counted(pieces, step):
    """Invariant: every byte is in a packet that encodes back to it, or counted as skipped, or waiting."""
    decoder, now, received = Decoder(), 0.0, 0
    for piece in pieces:
        for packet in decoder.feed(piece, now):
            received += len(encode_frame(*packet))
        now += step
    fed = sum(map(len, pieces))
    waiting = fed - received - decoder.skipped_bytes
    assert 0 <= waiting <= 254
    decoder.drop()
    assert decoder.skipped_bytes == fed - received
    assert decoder.feed(encode_frame(7, b"ok"), now) == [Packet(7, b"ok")]


PAUSE_S, MORE_BYTES = 0.05, 255
"""A whole valid frame is given out at the latest after this pause or so many more bytes."""


def valid_frames(stream):
    """Yield start and end of every valid frame in a stream, overlapping ones included."""
    for start in range(len(stream) - 5):
        end = start + stream[start + 2] + 3
        if stream[start : start + 2] == b"\xfa\xfb" and stream[start + 2] >= 3 and end <= len(stream):
            body, expected_sum = stream[start + 3 : end - 2], stream[end - 2 : end]
            if checksum(body).to_bytes(2, "big") == expected_sum:
                yield start, end


def feed_and_check(calls):
    """Feed (pause in s, bytes) one after the other; after each call, require every frame that is due."""
    stream = b"".join(data for _, data in calls)
    frames = list(valid_frames(stream))
    decoder, packets = Decoder(), []
    given = []
    now = last_s = 0.0
    fed = paused_at = 0
    for pause_s, data in calls:
        now += pause_s
        if now - last_s > PAUSE_S:
            paused_at = fed
        last_s = now if data else last_s
        fed += len(data)
        for packet in decoder.feed(data, now):
            packets.append(packet)
            frame = encode_frame(*packet)
            start = stream.index(frame, given[-1][1] if given else 0)
            assert start + len(frame) <= fed
            given.append((start, start + len(frame)))
        for start, end in frames:
            due = end <= paused_at or end + MORE_BYTES <= fed
            assert not due or any(start < other_end and other < end for other, other_end in given), (
                f"the frame at {start} to {end} is withheld; {fed} bytes came, {paused_at} before a pause"
            )
    return packets


SIP_FRAME = encode_frame(0x32, bytes(38))
PIECES = st.one_of(
    st.binary(max_size=20),
    st.sampled_from([b"\xfa", b"\xfa\xfb", b"\xfa\xfb\x06", b"\xfa\xfb\xfc", SIP_FRAME, SIP_FRAME[:-3]]),
    st.builds(encode_frame, st.integers(0, 255), st.binary(max_size=249)),
    st.builds(lambda inner: encode_frame(0xB0, encode_frame(1, inner)), st.binary(max_size=30)),
)
PAUSES = st.sampled_from([0.0, 0.01, 0.04, 0.06, 1.0])


@given(st.lists(PIECES, max_size=12), st.data())
def test_no_frame_is_withheld_beyond_a_pause_or_255_bytes_however_the_bytes_are_split(pieces, data):
    stream = b"".join(pieces)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    bounds = zip([0, *cuts], [*cuts, len(stream)], strict=True)  # an empty piece is a call of the timer
    feed_and_check([*((data.draw(PAUSES), stream[start:end]) for start, end in bounds), (0.06, b"")])
