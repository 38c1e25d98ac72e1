"""Drivers at a bridge with either base, on a virtual clock: messages, garbage, the key of a lease."""

import math

import pytest
from kit.bridge_bench import STOP_S, braking_s
from kit.virtual_bench import VirtualDriver, VirtualRig

from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.key_table import KEYS, Kind, Role, spec
from rover_ncp.wire.messages import decode, twist_stamped
from rover_ncp.wire.protocol import MotorsReply, parse_json
from sim.base.firmware import Firmware
from sim.stack.virtual import VirtualLink


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


NAN, UNREADABLE = "not-finite", "unreadable"
GARBAGE = [
    (twist_stamped(Velocity(math.nan, 0.1), 1), NAN, NAN),
    (twist_stamped(Velocity(0.2, 0.1), 1)[:-9], UNREADABLE, UNREADABLE),
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


@pytest.mark.parametrize("payload", [b"stop", b'{"release": true, "why": 1}'])
def test_a_stop_that_cannot_be_read_stops_and_releases_nothing(rig, driver, payload):
    driver.start()
    with pytest.raises(RuntimeError, match="StopRequest"):
        rig.query("rover/stop", payload)
    rig.wait_for(lambda: driver.gate.stop_reason == "a request that cannot be read")
    assert driver.gate.lease == 0
    assert driver.stop(release=True) is not None
    rig.wait_for(lambda: driver.motors().granted)


# The key of a lease


class TappedRig(VirtualRig):
    """A rig that keeps all messages and answers."""

    def __init__(self):
        super().__init__(load_description(DEFAULT_ROBOT))
        self.published, self.commands, self.answers = [], [], []
        self.sleep(3.0)

    def publish(self, name, data):
        self.published.append(data)
        super().publish(name, data)

    def command(self, data, attachment=None):
        self.commands.append((data, attachment))
        super().command(data, attachment)

    def query(self, name, payload, attachment=None):
        answer = super().query(name, payload, attachment)
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
