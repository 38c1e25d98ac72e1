"""Drivers at a bridge with either base, on a virtual clock: lease, stops, garbage, forged messages."""

import math
from collections import Counter

import pytest
from kit.bridge_bench import PERIOD_S, STOP_S, braking_s
from kit.virtual_bench import VirtualDriver, VirtualRig

from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.key_table import KEYS, Kind, Role, spec
from rover_ncp.wire.messages import decode, twist_stamped
from rover_ncp.wire.protocol import CommandTag, MotorsReply, MotorsRequest, Signed, dump_json, parse_json
from sim.base.firmware import Firmware
from sim.stack.virtual import VirtualBridge, VirtualLink


@pytest.fixture(params=["p3at-sh", "husky-a200"], ids=["arcos", "ros2"])
def rig(request):
    return VirtualRig(load_description(request.param))


@pytest.fixture
def driver(rig):
    return VirtualDriver(rig)


def test_every_message_of_the_table_is_published_and_can_be_read(rig, driver):
    promised = {row for row in KEYS if row.senders == {Role.BRIDGE} and row.kind is Kind.MESSAGE}
    driver.start().drive(1.0)
    no_such_input = {spec("docked"), spec("imu" if isinstance(rig.base, Firmware) else "sonar")}
    for row in promised - no_such_input:
        assert len(driver.seen[row.name]) <= row.max_bytes
        decode(row.type, driver.seen[row.name])


def test_a_second_driver_is_refused_and_its_commands_do_not_count(rig, driver):
    driver.start()
    other = VirtualDriver(rig)
    reply = other.motors()
    assert (reply.granted, reply.reason) == (False, "another-driver")
    assert reply.detail == "test holds the lease"
    for _ in range(5):
        other.send(v=-0.3)
        driver.drive(0.05)
    driver.drive(0.3)
    assert driver.gate.dropped == {"foreign": 5}
    assert driver.odom.velocity.v > 0.1
    driver.motors(enable=False)
    assert other.motors().granted


def test_a_stop_is_latched_until_it_is_released(rig, driver):
    driver.start()
    assert driver.stop().stopped
    driver.drive(0.5)
    assert rig.stands_after(braking_s(0.15))
    reply = driver.motors()
    assert (reply.granted, reply.reason) == (False, "stopped")
    assert "test" in reply.detail
    assert driver.gate.stop_reason == "test"
    assert not driver.stop(release=True).stopped
    driver.start()


NAN, UNREADABLE = "not-finite", "unreadable"
GARBAGE = [
    (twist_stamped(Velocity(math.nan, 0.1), 1), NAN, NAN),
    (twist_stamped(Velocity(math.inf, -math.inf), 1), NAN, NAN),
    (twist_stamped(Velocity(0.2, 0.1), 1)[:-9], UNREADABLE, UNREADABLE),
    (b"\0\1\0\0" + b"\xff" * 60, UNREADABLE, UNREADABLE),
    (b"", UNREADABLE, UNREADABLE),
    # The bridge digests no megabytes: the signature of what is too long cannot be valid.
    (b"\0\1\0\0" + b"\0" * 100_000, "foreign", "silence"),
]
"""Payloads, and why they are dropped and why the rover is held when its driver sends them."""


def test_garbage_from_the_driver_stops_the_rover(rig, driver):
    for data, dropped, held in GARBAGE:
        driver.start()
        before = driver.gate.dropped.get(dropped, 0)
        driver.drive(0.05)
        for _ in range(3):
            driver.put(data)
        rig.wait_for(lambda: driver.gate.held == held, STOP_S)  # noqa: B023
        assert driver.gate.dropped[dropped] == before + 3
        assert driver.out == Velocity(0.0, 0.0)
    assert rig.stands_after(braking_s(0.15))


# Requests for the motors


@pytest.fixture
def requester():
    """A driver that requests the motors itself."""
    driver = VirtualDriver(VirtualRig(load_description(DEFAULT_ROBOT)))
    driver.rig.wait_for(lambda: driver.odom is not None)
    return driver


@pytest.mark.parametrize(
    ("name", "payload", "expected"),
    [
        ("rover/motors", b"{}", "enable"),
        ("rover/stop", b'{"release": 1e999}', "StopRequest"),
        ("rover/stop", b" " * 100_000, "expected at most 4096"),
        ("rover/base", b"[]", "BaseRequest"),
    ],
)
def test_a_request_that_cannot_be_read_is_refused_by_name(requester, name, payload, expected):
    with pytest.raises(RuntimeError, match=expected):
        requester.rig.query(name, payload)


@pytest.mark.parametrize("payload", [b"stop", b'{"release": true, "why": 1}'])
def test_a_stop_that_cannot_be_read_stops_and_releases_nothing(requester, payload):
    requester.rig.wait_for(lambda: requester.motors().granted)
    with pytest.raises(RuntimeError, match="StopRequest"):
        requester.rig.query("rover/stop", payload)
    requester.rig.wait_for(lambda: requester.gate.stop_reason == "a request that cannot be read")
    assert requester.gate.lease == 0
    assert requester.stop(release=True) is not None
    requester.rig.wait_for(lambda: requester.motors().granted)


def test_a_lost_answer_locks_all_drivers_out_until_the_lease_lapses(requester):
    """The lease and its key are granted, but the answer never reaches the driver."""
    first = requester.motors()
    requester.lease.end()
    assert requester.motors().reason == "another-driver"
    again = requester.rig.wait_for(lambda: (reply := requester.motors()).granted and reply)
    assert (again.lease, again.key != first.key) == (first.lease + 1, True)


# The key of a lease


class TappedRig(VirtualRig):
    """A rig that keeps all messages, requests and answers."""

    def __init__(self):
        super().__init__(load_description(DEFAULT_ROBOT))
        self.published, self.commands, self.requests, self.answers = [], [], [], []
        self.sleep(3.0)

    def publish(self, name, data):
        self.published.append(data)
        super().publish(name, data)

    def command(self, data, attachment=None):
        self.commands.append((data, attachment))
        super().command(data, attachment)

    def query(self, name, payload, attachment=None):
        answer = super().query(name, payload, attachment)
        self.requests.append((payload, attachment))
        self.answers.append(parse_json(MotorsReply, answer))
        return answer


def test_the_key_is_in_the_first_answer_and_in_no_message_recording_or_state():
    rig, recorded = TappedRig(), []
    driver = VirtualLink(rig, Pose(0.0, 0.0, 0.0), recorded.append)
    driver.request_motors("test")
    for _ in range(20):
        driver.command(Velocity(0.1, 0.0))
        rig.sleep(0.1)
    driver.request_motors("test")
    driver.release()
    rig.sleep(0.5)

    grant, renewal, release = rig.answers
    assert (renewal.granted, renewal.lease, renewal.key) == (True, grant.lease, "")
    assert not release.granted
    sent = [part for command in rig.commands for part in command]
    messages = b"".join([*rig.published, *sent, *(message.data for message in recorded)])
    assert min(len(rig.published), len(recorded)) > 100
    for key in (bytes.fromhex(grant.key), grant.key.encode()):
        assert len(key) >= 32
        assert key not in messages
    assert grant.key not in f"{grant} {renewal!r} {driver.gate!r}"
    assert driver.gate.lease == 0


# A peer that tries to take over a drive: it receives all messages and requests, and knows no key


def attempts(rig, number):
    """Yield commands and requests of the peer, each with its tag."""
    _, tag = rig.commands[-1]
    backward = twist_stamped(Velocity(-0.25, 0.5), rig.time_ns())
    newest = CommandTag.unpack(tag)
    forged = [
        newest,
        newest._replace(sequence=newest.sequence + 1 + number),
        newest._replace(sequence=newest.sequence + 1000, stamp_ns=newest.stamp_ns + 50_000_000),
        newest._replace(sequence=newest.sequence + 1, digest=bytes([number % 256]) * 16),
    ]
    yield from ((None, backward, tag.pack()) for tag in forged)
    # Signed as the gate demands, by keys that it did not grant.
    following = newest._replace(sequence=newest.sequence + 1)
    for key in (b"", b"\x5a" * 32):
        yield None, backward, following.sign(key, Signed.COMMAND, "cmd_vel", backward).pack()
    yield (None, *rig.commands[number * 7 % len(rig.commands)])
    for enable in (True, False):
        request = dump_json(MotorsRequest(enable=enable, name="attacker", sent_ns=rig.now_ns))
        yield from (("rover/motors", request, tag) for tag in (None, forged[1].pack()))
    yield ("rover/motors", *rig.requests[0])


def test_1200_attempts_to_take_over_a_drive_fail_and_the_rover_drives_on():
    rig = TappedRig()
    driver = VirtualDriver(rig)
    driver.start()
    accepted, answers, outputs = driver.gate.accepted, Counter(), set()
    for number in range(100):
        driver.send()
        for name, payload, tag in attempts(rig, number):
            if name is None:
                VirtualBridge.command(rig, payload, tag)
            else:
                reply = parse_json(MotorsReply, VirtualBridge.query(rig, name, payload, tag))
                answers[reply.granted, reply.reason, reply.key] += 1
            outputs.add((driver.out, driver.gate.driver_name, driver.gate.lease))
            rig.sleep(PERIOD_S / 10)
    driver.drive(0.1)
    assert (driver.gate.accepted, sum(driver.gate.dropped.values())) == (accepted + 102, 700)
    assert answers == {(False, "another-driver", ""): 500}
    assert outputs == {(Velocity(0.15, 0.0), "test", driver.lease.number)}
    assert driver.odom.velocity.v == pytest.approx(0.15, abs=0.005)
