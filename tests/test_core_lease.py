"""Command tags and the JSON of the queries: exact bytes, and garbage refused."""

import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.core.errors import FormatError
from rover_ncp.core.lease import (
    CommandTag,
    DriverStatus,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    ResetRequest,
    StopRequest,
    dump_json,
    parse_json,
)

DRIVER = bytes(range(16))
MODELS = [MotorsRequest, MotorsReply, StopRequest, ResetRequest, GateStatus, DriverStatus]


def test_a_tag_is_32_little_endian_bytes():
    tag = CommandTag(DRIVER, 258, -2)
    assert tag.pack() == DRIVER + bytes([2, 1, 0, 0, 0, 0, 0, 0]) + b"\xfe" + b"\xff" * 7


@given(
    driver=st.binary(min_size=16, max_size=16),
    sequence=st.integers(0, 2**64 - 1),
    stamp_ns=st.integers(-(2**63), 2**63 - 1),
)
def test_a_tag_comes_back(driver, sequence, stamp_ns):
    tag = CommandTag(driver, sequence, stamp_ns)
    assert CommandTag.unpack(tag.pack()) == tag


@given(data=st.binary(max_size=80).filter(lambda data: len(data) != 32))
def test_a_tag_of_another_length_is_refused(data):
    with pytest.raises(FormatError, match="32 bytes"):
        CommandTag.unpack(data)


@pytest.mark.parametrize(
    "tag", [CommandTag(b"short", 1, 1), CommandTag(DRIVER, -1, 1), CommandTag(DRIVER, 1, 2**63)]
)
def test_a_tag_that_does_not_fit_is_refused(tag):
    with pytest.raises(FormatError):
        tag.pack()


def test_a_request_reads_as_documented():
    data = {"enable": True, "driver": DRIVER.hex(), "name": "deploy", "sent_ns": 12345}
    request = parse_json(MotorsRequest, json.dumps(data))
    assert json.loads(dump_json(request)) == data
    assert request.enable
    assert bytes.fromhex(request.driver) == DRIVER


@pytest.mark.parametrize(
    ("model", "data", "named"),
    [
        (MotorsRequest, b"", "JSON"),
        (MotorsRequest, b"[1]", "JSON"),
        (MotorsRequest, b'{"enable": true}', "driver"),
        (MotorsRequest, b'{"enable": true, "driver": "xyz"}', "driver"),
        (MotorsRequest, b'{"enable": true, "driver": "' + b"0" * 33 + b'"}', "driver"),
        (MotorsRequest, b'{"enable": "perhaps", "driver": "' + b"0" * 32 + b'"}', "enable"),
        (MotorsRequest, b'{"enable": true, "driver": "%s", "sent_ns": 1e30}' % (b"0" * 32), "sent_ns"),
        (MotorsRequest, b'{"enable": true, "driver": "%s", "speed": 9}' % (b"0" * 32), "speed"),
        (StopRequest, b'{"reason": "%s"}' % (b"x" * 201), "reason"),
        (ResetRequest, b'{"x": 1}', "x"),
        (ResetRequest, b"[" * 4_000, "JSON"),
        (ResetRequest, b" " * 20_000 + b"{}", "bytes"),
    ],
)
def test_a_wrong_request_is_refused_by_name(model, data, named):
    with pytest.raises(FormatError, match=named):
        parse_json(model, data)


@given(
    model=st.sampled_from(MODELS), data=st.binary(max_size=200) | st.from_regex(rb'\{"[a-z]+": ?.{0,20}\}')
)
def test_garbage_is_a_request_or_a_format_error(model, data):
    try:
        parse_json(model, data)
    except FormatError as error:
        assert "\n" not in str(error)


def test_the_tag_is_as_long_as_the_note_says():
    assert struct.calcsize("<16sQq") == len(CommandTag(DRIVER, 0, 0).pack()) == 32
