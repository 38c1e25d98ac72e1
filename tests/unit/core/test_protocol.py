"""Command tags and the JSON of the queries: exact bytes, and garbage refused."""

from hashlib import blake2b

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_ncp.core.errors import FormatError
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import twist_stamped
from rover_ncp.wire.protocol import (
    KEY_BYTES,
    BaseReply,
    BaseRequest,
    CommandTag,
    DriverStatus,
    GateStatus,
    MotorsReply,
    MotorsRequest,
    Signed,
    StopRequest,
    TimeoutState,
    dump_json,
    in_words,
    parse_json,
)

SECRET = bytes(range(32))


def test_a_tag_is_40_little_endian_bytes():
    tag = CommandTag(3, 258, -2, bytes(range(16)))
    numbers = bytes([3, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0]) + b"\xfe" + b"\xff" * 7
    assert tag.pack() == numbers + bytes(range(16))
    assert CommandTag(0, 0, 0).pack() == bytes(40)


@given(
    lease=st.integers(0, 2**64 - 1),
    sequence=st.integers(0, 2**64 - 1),
    stamp_ns=st.integers(-(2**63), 2**63 - 1),
    digest=st.binary(min_size=16, max_size=16),
)
def test_a_tag_comes_back(lease, sequence, stamp_ns, digest):
    tag = CommandTag(lease, sequence, stamp_ns, digest)
    assert CommandTag.unpack(tag.pack()) == tag


@given(data=st.binary(max_size=80).filter(lambda data: len(data) != 40))
def test_a_tag_of_another_length_is_refused(data):
    with pytest.raises(FormatError, match="40 bytes"):
        CommandTag.unpack(data)


@pytest.mark.parametrize("tag", [(1, 1, 1, b"short"), (-1, 1, 1), (1, -1, 1), (1, 1, 2**63)])
def test_a_tag_that_does_not_fit_is_refused_and_not_signed(tag):
    with pytest.raises(FormatError):
        CommandTag(*tag).pack()
    with pytest.raises(FormatError):
        CommandTag(1, 2**64, 1).sign(SECRET, Signed.COMMAND, "cmd_vel", b"")


@pytest.mark.parametrize(("kind", "byte"), [(Signed.COMMAND, "01"), (Signed.MOTORS, "02")])
def test_a_digest_covers_the_bytes_that_the_documentation_lists(kind, byte):
    numbers = bytes.fromhex("0300000000000000" + "0400000000000000" + "feffffffffffffff")
    signed = bytes.fromhex("02" + byte + "0b00") + numbers + b"lab/cmd_vel" + b"payload"
    expected = blake2b(signed, digest_size=16, key=SECRET, person=b"rover-ncp lease")
    tag = CommandTag(3, 4, -2).sign(SECRET, kind, "lab/cmd_vel", b"payload")
    assert tag.digest == expected.digest()
    assert tag.verify(SECRET, kind, "lab/cmd_vel", b"payload")


@pytest.mark.parametrize(
    "change",
    [
        *({"lease": 4}, {"sequence": 5}, {"stamp_ns": -3}, {"digest": bytes(16)}),
        *({"key": bytes(32)}, {"kind": Signed.MOTORS}, {"key_expr": "cmd_vel"}),
        {"key_expr": "bot1/cmd_velp", "payload": b"ayload"},
        {"payload": b"payload\0"},
    ],
    ids=str,
)
def test_a_digest_is_for_one_message_alone(change):
    message = {"key": SECRET, "kind": Signed.COMMAND, "key_expr": "bot1/cmd_vel", "payload": b"payload"}
    tag = CommandTag(3, 4, -2).sign(*message.values())
    of_tag = {name: value for name, value in change.items() if name not in message}
    assert not tag._replace(**of_tag).verify(*(change.get(name, value) for name, value in message.items()))
    assert tag.verify(*message.values())


def test_signing_and_verifying_a_command(benchmark):
    payload = twist_stamped(Velocity(0.1, -0.2), 10**18)

    def sign_and_verify():
        attachment = CommandTag(3, 4, 5).sign(SECRET, Signed.COMMAND, "bot1/cmd_vel", payload).pack()
        return CommandTag.unpack(attachment).verify(SECRET, Signed.COMMAND, "bot1/cmd_vel", payload)

    assert benchmark(sign_and_verify)


def test_the_key_is_in_no_text_about_an_answer():
    reply = MotorsReply(granted=True, lease=1, key="ab" * KEY_BYTES)
    assert "abab" not in repr(reply)
    assert "abab" not in str(reply)
    with pytest.raises(FormatError) as error:
        parse_json(MotorsReply, b'{"granted": true, "key": "%s"}' % (b"ab" * 5))
    assert "abab" not in str(error.value)


@pytest.mark.parametrize(
    ("message", "values"),
    [
        (MotorsRequest(enable=True), {"sent_ns": 0}),
        (MotorsReply(), {"granted": False, "lease": 0}),
        (StopRequest(), {"release": False}),
        (BaseReply(model="x", state=TimeoutState.UNKNOWN), {"wall_ns": 0}),
        (GateStatus(), {"lease": 0, "sequence": -1, "accepted": 0}),
        (DriverStatus(state="x"), {"tick": 0, "t_s": 0.0, "overruns": 0}),
    ],
)
def test_what_a_sender_leaves_out_grants_and_releases_nothing(message, values):
    assert {name: getattr(message, name) for name in values} == values
    assert parse_json(type(message), dump_json(message)) == message


def test_statuses_in_recordings_of_earlier_versions_are_read():
    assert parse_json(DriverStatus, '{"state": "driving", "second_publisher": ""}').state == "driving"


def test_the_largest_values_are_read():
    for sent_ns in (-(2**63), 2**63 - 1):
        assert parse_json(MotorsRequest, b'{"enable": true, "sent_ns": %d}' % sent_ns).sent_ns == sent_ns
    reply = parse_json(MotorsReply, b'{"lease": %d, "key": "%s"}' % (2**64 - 1, b"ab" * 32))
    assert (reply.lease, reply.key) == (2**64 - 1, "ab" * 32)
    assert parse_json(BaseRequest, b" " * 4094 + b"{}") == BaseRequest()


@pytest.mark.parametrize(
    ("before", "now", "contact"),
    [
        ({}, {"held": "bumper"}, "a bumper is pressed"),
        ({}, {"ended": "stall"}, "a motor is stalled"),
        ({}, {"held": "silence", "ended": "low-battery", "stops": {"silence": 1}}, ""),
        ({}, {"stops": {"silence": 2, "bumper": 1}}, "a bumper is pressed"),
        ({"stops": {"bumper": 1}}, {"stops": {"bumper": 1}}, ""),
        ({"stops": {"bumper": 1}}, {"stops": {"bumper": 2}}, "a bumper is pressed"),
    ],
)
def test_contact_is_reported_in_words_if_it_is_new(before, now, contact):
    assert GateStatus(**now).contact_since(GateStatus(**before)) == contact


def test_words_of_a_reason():
    assert in_words("bumper") == "bumper: a bumper is pressed"
    assert in_words("bumper", "the front one") == "bumper: the front one"
    assert in_words("a reason of a later version") == "a reason of a later version"


@pytest.mark.parametrize(
    ("model", "data", "named"),
    [
        (MotorsRequest, b"", "MotorsRequest: JSON: "),
        (MotorsRequest, b'{"enable": "perhaps"}', "enable"),
        (MotorsRequest, b'{"enable": true, "speed": 9}', "speed"),
        (MotorsReply, b'{"granted": true, "key": "00"}', "key"),
        (MotorsReply, b'{"granted": true, "lease": -1}', "lease"),
        (MotorsReply, b'{"granted": true, "lease": %d}' % 2**64, "lease"),
        (MotorsRequest, b'{"enable": true, "sent_ns": %d}' % 2**63, "sent_ns"),
        (MotorsRequest, b'{"enable": true, "sent_ns": %d}' % -(2**63 + 1), "sent_ns"),
        (StopRequest, b'{"reason": "%s"}' % (b"x" * 201), "reason"),
        (BaseRequest, b"[" * 4_000, "JSON"),
        (BaseRequest, b" " * 4_095 + b"{}", "4097 bytes, expected at most 4096"),
    ],
)
def test_a_wrong_request_is_refused_by_name(model, data, named):
    with pytest.raises(FormatError, match=named):
        parse_json(model, data)
