"""Peers beside the bridge that publish or answer in its place, and another model of robot."""

import time
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
import zenoh
from kit.bridge_bench import client, wait_for
from kit.peer import Peer

from deploy.drive.config import DriveConfig
from deploy.drive.measurements import Measurements
from deploy.drive.safety_monitor import SafetyMonitor
from deploy.drive.start import StartDetector
from deploy.drive.zenoh_link import ZenohLink
from deploy.publishers import INPUTS, Publishers
from deploy.view.server import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NoBridge, NoPose
from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.robot.description import load_description
from rover_ncp.wire.messages import battery_state, bumpers, imu, odometry, pose_with_covariance, text
from rover_ncp.wire.protocol import BaseReply, GateStatus, MotorsReply, StopReply, TimeoutState, dump_json
from rover_ncp.wire.zenoh import client_config

STANDS = Pose(0.0, 0.0, 0.0)
MESSAGES = {
    "odom": lambda now_ns: odometry(STANDS, Velocity(0.0, 0.0), now_ns),
    "pose": lambda now_ns: pose_with_covariance(STANDS, np.eye(3) * 1e-4, now_ns, "course"),
}
ANSWERS = {
    "rover/stop": dump_json(StopReply(stopped=False, reason="false")),
    "rover/base": dump_json(BaseReply(model="false", state=TimeoutState.UNKNOWN)),
}


class Publisher(Peer):
    """Publishes an input on its key; its clock is ``late_s`` late."""

    def __init__(self, rig, name, late_s=0.0):
        super().__init__(client_config(rig.robot, None)[0])
        self._name, self._late_ns = name, round(late_s * 1e9)

    def run(self):
        while not self.closing.wait(0.02):
            self.session.put(self._name, MESSAGES[self._name](time.time_ns() - self._late_ns))


@contextmanager
def counted(rig):
    """Count the publishers of each input as a check does."""
    publishers = Publishers()
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link:
        link.listen(INPUTS, publishers.note)
        yield publishers


@pytest.mark.parametrize(("name", "clocks_s"), [("odom", [0.0]), ("pose", [0.0, 5.0])])
def test_a_second_publisher_of_an_input_is_found(rig, name, clocks_s):
    with counted(rig) as found, ExitStack() as publishers:
        for late_s in clocks_s:
            publishers.enter_context(Publisher(rig, name, late_s))
        wait_for(lambda: any(f"publishers send {name}" in words for words in found.problems("")), 10.0)


def test_one_publisher_of_each_is_not_reported(rig):
    with counted(rig) as found, Publisher(rig, "pose"):
        time.sleep(2.0)
        assert list(found.problems("")) == []
        assert found.elsewhere("pose", "bot1") == [""]


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


def test_pose_that_is_too_long_is_named(rig):
    long = pose_with_covariance(STANDS, np.eye(3) * 1e-4, 1, "m" * 100_000)
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link, client(rig.robot) as peer:
        config = DriveConfig(
            robot=rig.robot, policy="p", course="c", ticks=1, pose="required", pose_wait_s=1.0
        )
        measurements = Measurements(link)
        monitor = SafetyMonitor(link, measurements, lambda: False, config)
        monitor.wait(drives=False)
        peer.put("pose", long, congestion_control=zenoh.CongestionControl.BLOCK)
        with pytest.raises(NoPose, match=r"100[0-9]{3} bytes, expected at most 4096"):
            StartDetector(link, measurements, config, time).wait(monitor)


@pytest.fixture(params=["false", "unreadable", "silent"])
def false_answerer(rig, request):
    """A peer that answers at once, or holds each query until its end."""
    held = []

    def answer(query):
        name = str(query.key_expr)
        if request.param == "silent":
            held.append(query)
        else:
            with query:
                query.reply(name, ANSWERS[name] if request.param == "false" else b"{")

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


def test_another_model_is_a_warning_to_a_driver_and_a_finding_of_check(rig, run_json):
    with ZenohLink(BridgeAddress(rig.robot), lambda message: None) as link:
        assert "drives p3at-sh, but --model is turtlebot4" in link.other_model(load_description("turtlebot4"))
        assert link.other_model(load_description("p3at-sh")) == ""
        assert link.other_model(None) == ""  # the default robot
    code, fields = run_json(f"check --robot {rig.robot} --on-blocks --model turtlebot4")
    (finding,) = fields["findings"]
    assert (code, finding["name"], finding["ok"]) == (1, "model", False)
    assert "the bridge drives p3at-sh, expected turtlebot4" in finding["detail"]
