"""Any bytes from a line, a network or a file give a result or the package's own error."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.fuzz_readers import READERS, survives

EXAMPLES = {"line": 150, "cdr": 150, "json": 300, "robot": 60, "yaml": 40, "contents": 60}
PIECES = [b"", b"\xff" * 4, b"\0" * 8, b".nan", b"-.inf", b"1e999", b"[" * 40, b"{a: [", b"&a [*a]"]
PIECES += [b"2001-99-99", b"\xfa\xfb"]


@st.composite
def corrupted(draw, samples):
    """A sample with pieces cut out, doubled, put in, and bytes changed."""
    data = bytearray(draw(st.sampled_from(samples)))
    for _ in range(draw(st.integers(1, 4))):
        begin = draw(st.integers(0, len(data)))
        end = draw(st.integers(begin, min(len(data), begin + 60)))
        change = draw(st.sampled_from(["cut", "double", "put", "flip", "end"]))
        if change == "cut":
            del data[begin:end]
        elif change == "double":
            data[begin:begin] = data[begin:end]
        elif change == "put":
            data[begin:end] = draw(st.sampled_from(PIECES) | st.binary(max_size=12))
        elif change == "flip" and begin < len(data):
            data[begin] ^= draw(st.integers(1, 255))
        elif change == "end":
            del data[end:]
    return bytes(data)


@pytest.mark.parametrize("name", READERS)
def test_any_bytes_are_read_or_rejected(name):
    reader = READERS[name]
    samples = list(reader.samples())
    for sample in samples:
        survives(reader, sample)

    @settings(max_examples=EXAMPLES.get(name, 60) * settings().max_examples // 100)
    @given(data=st.binary(max_size=300) | corrupted(samples) | corrupted(samples))
    def read(data):
        survives(reader, data)

    read()
