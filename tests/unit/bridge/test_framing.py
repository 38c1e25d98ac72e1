"""The codec, on bytes of third parties first: recorded clients, recorded robots, examples in manuals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.arcos_captures import CAPTURES, VECTORS

from bridge.pioneer.framing import Decoder, Packet, encode_frame

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


@pytest.mark.parametrize(("more", "pause_s"), [(b"", 0.06), (bytes(255), 0.01)], ids=["a pause", "255 bytes"])
def test_a_frame_behind_a_false_header_is_withheld_for_a_pause_or_255_bytes_at_most(more, pause_s):
    decoder = Decoder()
    assert decoder.feed(b"\xfa\xfb\xfc" + encode_frame(0x32, bytes(38)), 0.0) == []
    assert decoder.feed(more, pause_s) == [Packet(0x32, bytes(38))]
