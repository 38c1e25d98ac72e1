"""The bridge's answers to requests for the motors; with real processes where a peer interferes."""

import json
import struct
import threading
import time

import pytest
from kit.bridge_bench import Driver, Rig, client, wait_for
from kit.virtual_bench import VirtualDriver, VirtualRig

from deploy.drive.zenoh_link import ZenohLink
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NoBridge
from rover_ncp.core.files import DEFAULT_ROBOT
from rover_ncp.core.geometry import Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import text, twist_stamped
from rover_ncp.wire.protocol import CommandTag, MotorsReply, MotorsRequest, Signed, dump_json

OLD_REQUEST = {"enable": True, "driver": "ab" * 16, "name": "old", "sent_ns": 1}
BOTH = (
    "the bridge uses protocol version 2, the driver version 1: install the same version of rover-ncp on both"
)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig"), bridge=["--accept-ros"]) as rig:
        yield rig


@pytest.fixture
def driver(rig):
    with Driver(rig.locator) as driver:
        wait_for(lambda: driver.odom is not None)
        yield driver
        driver.motors(enable=False)
        wait_for(lambda: driver.gate.lease == 0)
        time.sleep(1.0)  # after which plain commands may drive again


@pytest.fixture
def virtual():
    """A driver on a virtual clock."""
    driver = VirtualDriver(VirtualRig(load_description(DEFAULT_ROBOT), accept_ros=True))
    driver.rig.wait_for(lambda: driver.odom is not None)
    return driver


def test_a_lost_answer_locks_all_drivers_out_until_the_lease_lapses(virtual):
    """The lease and its key are granted, but the answer never reaches the virtual."""
    first = virtual.rig.wait_for(lambda: (reply := virtual.motors()).granted and reply)
    virtual.lease.end()
    assert virtual.motors().reason == "another-driver"
    again = virtual.rig.wait_for(lambda: (reply := virtual.motors()).granted and reply)
    assert (again.lease, again.key != first.key) == (first.lease + 1, True)


def test_a_signature_is_for_one_kind_and_one_key_expression(virtual):
    virtual.rig.wait_for(lambda: virtual.motors().granted)
    release = dump_json(MotorsRequest(enable=False))
    others = [(Signed.COMMAND, "rover/motors"), (Signed.MOTORS, "cmd_vel"), (Signed.MOTORS, "x/rover/motors")]
    for kind, where in others:
        tag = virtual.lease.sign(kind, where, release, virtual.rig.now_ns).pack()
        assert json.loads(virtual.ask("rover/motors", release, tag))["reason"] == "another-driver"
    foreign = virtual.gate.dropped.get("foreign", 0)
    command = twist_stamped(Velocity(0.1, 0.0), 1)
    virtual.put(command, virtual.lease.sign(Signed.MOTORS, "cmd_vel", command, virtual.rig.now_ns).pack())
    virtual.rig.wait_for(lambda: virtual.gate.dropped.get("foreign", 0) == foreign + 1)
    virtual.motors(enable=False)
    virtual.rig.wait_for(lambda: virtual.gate.lease == 0)


def test_an_older_driver_gets_both_versions(virtual):
    reply = json.loads(virtual.ask("rover/motors", json.dumps(OLD_REQUEST).encode()))
    assert reply == {"granted": False, "reason": "version", "detail": BOTH}
    later = json.loads(virtual.ask("rover/motors", b'{"version": 3, "anything": []}'))
    assert "the bridge uses protocol version 2, the driver version 3" in later["detail"]


OLD_ZEROS = struct.pack("<16sQq", bytes(16), 2**63, 2**62)
"""A tag of protocol version 1 with the id under which plain ROS commands drove."""


@pytest.mark.parametrize("tag", [OLD_ZEROS, bytes(40), CommandTag(0, 2**63, 2**62).pack(), b""])
def test_a_tag_of_zeros_neither_drives_nor_releases_under_accept_ros(virtual, tag):
    def plain():
        virtual.put(twist_stamped(Velocity(0.0, 0.0), virtual.rig.time_ns()))
        return virtual.gate.driver_name == "ros"

    virtual.rig.wait_for(plain)
    before = virtual.gate.dropped.get("foreign", 0)
    for _ in range(5):
        plain()
        virtual.put(twist_stamped(Velocity(0.2, 0.0), virtual.rig.time_ns()), tag)
        for request in (OLD_REQUEST | {"driver": "0" * 32, "enable": False}, {"version": 2, "enable": False}):
            answer = json.loads(virtual.ask("rover/motors", json.dumps(request).encode(), tag))
            assert (answer["granted"], answer["reason"]) == (False, "another-driver")
    virtual.rig.wait_for(lambda: virtual.gate.dropped.get("foreign", 0) == before + 5)
    assert virtual.gate.driver_name == "ros"
    assert virtual.out == Velocity(0.0, 0.0)


def test_a_peer_that_relays_the_request_does_not_get_to_share_the_key(rig):
    """It asks the bridge in the driver's place, and hands the answer on: then two have answered."""
    peer = client(rig.locator)

    def relay(query):
        request = query.payload.to_bytes()

        def ask(query=query):
            with query:
                for reply in other.session.get("rover/motors", payload=request, timeout=0.5):
                    if reply.ok is not None:
                        query.reply("rover/motors", reply.ok.payload.to_bytes())
                        return

        threading.Thread(target=ask, daemon=True).start()

    with Driver(rig.locator) as other, ZenohLink(BridgeAddress(rig.locator), lambda _: None) as link:
        wait_for(lambda: other.odom is not None)
        held = peer.declare_queryable("rover/motors", relay, complete=True)
        time.sleep(0.3)
        with pytest.raises(NoBridge, match="expected one: a peer beside the bridge answers") as error:
            link.request_motors("test")
        assert error.value.exit_code == 3
        assert link.lease.number == 0
        held.undeclare()
        wait_for(lambda: other.gate.lease == 0)
    peer.close()


def test_a_false_grant_with_a_key_of_its_own_drives_nothing(rig):
    """A peer answers beside the bridge: the driver refuses, and the bridge what such a key signs."""
    peer = client(rig.locator)
    grant = MotorsReply(granted=True, lease=99, key="5a" * 32, lease_s=5.0)
    with Driver(rig.locator) as other, ZenohLink(BridgeAddress(rig.locator), lambda _: None) as link:
        wait_for(lambda: other.odom is not None)
        answering = peer.declare_queryable(
            "rover/motors", lambda query: query.reply("rover/motors", dump_json(grant)), complete=True
        )
        time.sleep(0.3)
        with pytest.raises(NoBridge, match="expected one: a peer beside the bridge answers"):
            link.request_motors("test")
        assert link.lease.number == 0
        answering.undeclare()
        accepted = other.gate.accepted
        other.lease.grant(grant)
        refused = sum(other.gate.dropped.values())
        other.drive(0.5)
        wait_for(lambda: sum(other.gate.dropped.values()) >= refused + 3)
        assert other.gate.accepted == accepted
        assert abs(other.odom.velocity.v) < 0.01
        other.lease.end()
        wait_for(lambda: other.gate.lease == 0)
    peer.close()


@pytest.mark.parametrize("number", ["the driver's", "another"])
def test_a_false_gate_status_ends_no_check_of_the_key(rig, driver, number):
    """It may hide what the gate drops, or say that the lease is another's; it gives no peer the lease."""
    wait_for(lambda: driver.motors().granted)
    held = driver.lease.number
    status = driver.gate.model_copy(
        update={"lease": held if number == "the driver's" else held + 1, "sequence": 10**6}
    )
    peer = client(rig.locator)
    accepted = driver.gate.accepted
    for _ in range(5):
        peer.put("rover/gate", text(dump_json(status).decode()))
        payload = twist_stamped(Velocity(-0.25, 0.5), time.time_ns())
        tag = CommandTag(held, 10**6 + 1, time.monotonic_ns()).sign(b"", Signed.COMMAND, "cmd_vel", payload)
        peer.put("cmd_vel", payload, attachment=tag.pack())
        time.sleep(0.05)
    wait_for(lambda: driver.gate.lease == held and driver.gate.sequence < 10**6)
    assert driver.gate.accepted == accepted
    assert driver.out is None or driver.out == Velocity(0.0, 0.0)
    peer.close()
