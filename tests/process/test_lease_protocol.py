"""Peers that interfere with a driver's lease: a real bridge and real Zenoh sessions."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from kit.bridge_bench import Driver, client, wait_for

from deploy.drive.zenoh_link import ZenohLink
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NoBridge
from rover_ncp.core.geometry import Velocity
from rover_ncp.wire.messages import text, twist_stamped
from rover_ncp.wire.protocol import CommandTag, MotorsReply, Signed, dump_json


@pytest.fixture
def driver(rig):
    with Driver(rig.robot) as driver:
        driver.wait_for(lambda: {"odom", "rover/gate"} <= driver.seen.keys() and driver.gate.lease == 0)
        yield driver
        # It lapses: a query could still go to a peer of the test, which is gone.
        driver.wait_for(lambda: driver.gate.lease == 0)


@pytest.fixture
def peer(rig):
    peer = client(rig.robot)
    yield peer
    peer.close()


@pytest.fixture
def answering(rig, peer):
    """Let the peer answer requests for the motors beside the bridge, which a driver must notice."""

    def answer(give):
        held = peer.declare_queryable("rover/motors", give, complete=True)
        with ZenohLink(BridgeAddress(rig.robot), lambda _: None) as link:
            time.sleep(0.3)
            with pytest.raises(NoBridge, match="expected one: a peer beside the bridge answers") as error:
                link.request_motors("test")
            assert error.value.exit_code == 3
            assert link.lease.number == 0
        held.undeclare()

    return answer


def test_a_peer_that_relays_the_request_does_not_get_to_share_the_key(driver, answering):
    """It asks the bridge in the driver's place, and hands the answer on: then two have answered."""

    def relay(query):
        with query:
            for reply in driver.session.get("rover/motors", payload=query.payload, timeout=0.5):
                if reply.ok is not None:
                    query.reply("rover/motors", reply.ok.payload.to_bytes())
                    return

    with ThreadPoolExecutor() as pool:  # waits for its threads: none outlives the session
        answering(lambda query: pool.submit(relay, query))


def test_a_false_grant_with_a_key_of_its_own_drives_nothing(driver, answering):
    """A peer answers beside the bridge: the driver refuses, and the bridge what such a key signs."""
    grant = MotorsReply(granted=True, lease=99, key="5a" * 32, lease_s=5.0)
    answering(lambda query: query.reply("rover/motors", dump_json(grant)))
    accepted, dropped = driver.gate.accepted, sum(driver.gate.dropped.values())
    driver.lease.grant(grant)
    driver.drive(0.5)
    wait_for(lambda: sum(driver.gate.dropped.values()) >= dropped + 3)
    assert driver.gate.accepted == accepted
    assert abs(driver.odom.velocity.v) < 0.01


def test_a_false_gate_status_ends_no_check_of_the_key(driver, peer):
    """It may hide what the gate drops, or say that the lease is another's; it gives no peer the lease."""
    wait_for(lambda: driver.motors().granted)
    held, status = driver.lease.number, driver.gate
    accepted = driver.gate.accepted
    for lease in [held] * 5 + [held + 1] * 5:
        false = status.model_copy(update={"lease": lease, "sequence": 10**6})
        peer.put("rover/gate", text(dump_json(false).decode()))
        payload = twist_stamped(Velocity(-0.25, 0.5), time.time_ns())
        tag = CommandTag(held, 10**6 + 1, time.monotonic_ns()).sign(b"", Signed.COMMAND, "cmd_vel", payload)
        peer.put("cmd_vel", payload, attachment=tag.pack())
        time.sleep(0.05)
    wait_for(lambda: driver.gate.lease == held and driver.gate.sequence < 10**6)
    assert driver.gate.accepted == accepted
    assert driver.out is None or driver.out == Velocity(0.0, 0.0)
