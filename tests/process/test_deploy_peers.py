"""Peers beside the bridge that publish or answer in its place, and another model of robot."""

import time

import pytest
import zenoh
from kit.bridge_bench import Driver, client, wait_for
from kit.peer import Peer

from deploy.drive.zenoh_link import ZenohLink
from deploy.publishers import INPUTS, Publishers
from deploy.view.server import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NoBridge
from rover_ncp.core.geometry import ORIGIN, STANDSTILL, Pose, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.robot.profile import RoverProfile
from rover_ncp.wire.messages import battery_state, bumpers, imu, odometry, text
from rover_ncp.wire.protocol import BaseReply, GateStatus, MotorsReply, StopReply, TimeoutState, dump_json
from rover_ncp.wire.zenoh import client_config

ANSWERS = {
    "rover/stop": dump_json(StopReply(stopped=False, reason="false")),
    "rover/base": dump_json(BaseReply(model="false", state=TimeoutState.UNKNOWN)),
}


class Publisher(Peer):
    """Publishes odometry beside the bridge."""

    def __init__(self, rig):
        super().__init__(client_config(rig.robot, None)[0])

    def run(self):
        while not self.closing.wait(0.02):
            self.session.put("odom", odometry(ORIGIN, STANDSTILL, time.time_ns()))


def test_a_second_publisher_of_an_input_is_found(rig):
    found = Publishers()
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link, Publisher(rig):
        link.listen(INPUTS, found.note)
        wait_for(lambda: any("publishers send odom" in words for words in found.problems("")), 10.0)


def test_a_check_hears_each_message_once_and_in_order(rig):
    """A message that is heard twice is older than the newest one: as if two publishers sent it."""
    heard = []
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link, client(rig.robot) as peer:
        link.listen(INPUTS, lambda key_expr, source, data: heard.append((key_expr, data)))
        keys = ["pose", "hall/pose"]
        publishers = {key_expr: peer.declare_publisher(key_expr) for key_expr in keys}
        wait_for(lambda: all(publisher.matching_status.matching for publisher in publishers.values()))
        for number in range(50):
            for publisher in publishers.values():
                publisher.put(str(number))
        wait_for(lambda: all((key_expr, b"49") in heard for key_expr in keys))
        time.sleep(0.2)
    for key_expr in keys:
        assert [int(data) for key, data in heard if key == key_expr] == list(range(50))


BASE = {
    "battery_state": battery_state(12.34, 1, charging=True),
    "bumpers": bumpers(True, True),
    "imu": imu(0.5, 1.0, 1),
    "odom": odometry(Pose(9.0, 9.0, 0.0), Velocity(0.0, 0.0), 1),
    "rover/gate": text(dump_json(GateStatus(lease=99, ended="bumper")).decode()),
}


def test_what_the_base_reports_counts_from_the_bridge_alone(rig):
    """A false charge would be a proof of a docking, false contact the end of a drive."""
    received = []
    with ZenohLink(BridgeAddress(rig.robot), received.append) as link, client(rig.robot) as peer:
        wait_for(lambda: link.odometry.take(0.1))
        for name, data in BASE.items():
            publisher = peer.declare_publisher(name)
            publisher.put(data)
            publisher.put(data, source_info=zenoh.SourceInfo(publisher.id, 1))
        time.sleep(0.5)
        wait_for(lambda: link.odometry.take(0.1))
    assert {message.topic for message in received} >= {"odom", "rover/gate", "bumpers"}
    assert not [message.topic for message in received if message.data in BASE.values()]


def test_a_model_and_a_profile_of_another_robot_are_named(rig):
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link:
        wait_for(link.about_base)
        model = link.about_base().model
        assert f"drives {model}, but --model is turtlebot4" in link.other_model(
            load_description("turtlebot4")
        )
        other, own, unknown = (
            RoverProfile(name="rover", measured=measured)
            for measured in ({"model": "turtlebot4"}, {"model": model}, {})
        )
        assert f"measured with turtlebot4, and the bridge at {rig.robot} drives {model}" in (
            link.other_profile(other)
        )
        assert [link.other_profile(profile) for profile in (own, unknown, None)] == [""] * 3


@pytest.fixture(params=["false", "silent"])
def false_answerer(rig, request):
    """A peer that answers at once, or holds each query until its end."""
    held = []

    def answer(query):
        name = str(query.key_expr)
        if request.param == "silent":
            held.append(query)
        else:
            with query:
                query.reply(name, ANSWERS[name])

    session = client(rig.robot)
    queryables = [session.declare_queryable(name, answer) for name in ANSWERS]
    yield queryables
    session.close()


def test_only_the_bridges_answer_counts(rig, false_answerer):
    with Viewer(BridgeAddress(rig.robot), lambda message: None) as viewer:
        wait_for(lambda: viewer.may_stop)
        took_s = []
        for release in (False, True) * 3:
            began_s = time.monotonic()
            assert viewer.stop(release).stopped is not release
            took_s.append(time.monotonic() - began_s)
        assert min(took_s) < 0.9  # it waits for no other answer; a busy machine delays some
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link:
        assert [link.about_base().model for _ in range(5)] == ["p3at-sh"] * 5


def test_a_driver_that_gets_two_answers_about_the_motors_does_not_start(rig):
    grant = MotorsReply(granted=True, lease=99, key="5a" * 32)
    with client(rig.robot) as peer, ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link:
        peer.declare_queryable(
            "rover/motors", lambda query: query.reply("rover/motors", dump_json(grant)), complete=True
        )
        time.sleep(0.3)
        with pytest.raises(NoBridge, match="expected one: a peer beside the bridge answers") as error:
            link.request_motors("test")
        assert error.value.exit_code == 3
        assert link.lease.number == 0
        # The bridge's own grant ends unused; the next test's driver would be refused until then.
        wait_for(lambda: link.gate.driver_name == "test", 5.0)
        wait_for(lambda: link.gate.driver_name == "", 5.0)


def test_a_query_that_does_not_name_a_request_makes_none(rig):
    with Driver(rig.robot) as driver:
        wait_for(lambda: driver.odom is not None)
        for selector in ("**", "rover/*", "**/base"):
            replies = list(driver.session.get(selector, timeout=0.5))
            assert any("is not the key" in reply.err.payload.to_string() for reply in replies if reply.err)
            assert [reply for reply in replies if reply.ok] == []
        assert driver.gate.stop_reason == ""
        (reply,) = driver.session.get("**/stop", payload=b'{"reason": "all"}')
        assert reply.ok is not None
        wait_for(lambda: driver.gate.stop_reason == "all")
        driver.stop(release=True)
