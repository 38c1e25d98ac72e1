"""Publishers of the inputs, by namespaces, ids and stamps, and whose messages a driver takes."""

import pytest

from deploy.publishers import Publishers
from deploy.zenoh_client import BridgeFilter
from rover_ncp.core.geometry import ORIGIN, STANDSTILL
from rover_ncp.wire.key_table import spec
from rover_ncp.wire.messages import odometry

S = 10**9
RMW = "0/bot1/pose/geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/RIHS01_1"


def problems(messages, namespace=""):
    publishers = Publishers()
    for key_expr, source, stamp_s in messages:
        # All inputs begin with a header.
        publishers.note(key_expr, source, odometry(ORIGIN, STANDSTILL, stamp_s * S))
    return list(publishers.problems(namespace)), publishers


@pytest.mark.parametrize("ids", [("a", "b"), ("", "b")])
def test_two_ids_of_an_input_are_two_publishers(ids):
    found, _ = problems([("odom", source, k) for k in range(5) for source in ids])
    assert found == [f"{len(ids)} publishers send odom, expected one"]


def test_one_publisher_of_each_is_no_problem_and_a_late_message_is_none():
    one = [
        (topic, source, k) for k in range(20) for topic, source in [("odom", "a"), ("imu", "a"), ("pose", "")]
    ]
    assert problems([*one, ("pose", "", 3), ("bot2/odom", "b", 1), ("rover/gate", "c", 0)])[0] == []


def test_publishers_without_an_id_are_found_by_stamps_that_go_back():
    found, _ = problems([("pose", "", k - (k % 2) * 5) for k in range(10)])
    assert found == ["two publishers send pose, or one sends it out of order"]


def test_gyro_of_another_than_the_bridge_is_a_problem():
    found, _ = problems(
        [(topic, source, k) for k in range(5) for topic, source in [("odom", "a"), ("imu", "b")]]
    )
    assert found == ["odom and imu come from two publishers, expected the bridge for both"]


def test_input_in_another_namespace_is_named():
    _, publishers = problems([("bot2/pose", "", 1), (RMW, "", 1), ("odom", "a", 1)])
    assert publishers.elsewhere("pose", "") == ["bot1", "bot2"]
    assert publishers.elsewhere("pose", "bot1") == ["bot2"]
    assert publishers.elsewhere("odom", "bot1") == [""]


def test_messages_of_other_peers_are_dropped_once_the_bridge_has_sent_one():
    found = BridgeFilter(lambda: ["bridge"])
    assert found.accepts(spec("odom"), "bridge")
    for peer in ("peer", None):
        assert [found.accepts(spec(name), peer) for name in ("odom", "rover/gate", "docked")] == [False] * 3


@pytest.mark.parametrize("connected", [[], ["router"]])
def test_behind_a_router_the_messages_of_all_peers_count(connected):
    found = BridgeFilter(lambda: connected)
    assert all(found.accepts(spec("odom"), peer) for peer in ("bridge", "peer", None))


def test_bridge_that_connects_again_is_known_by_its_new_id():
    ids = ["bridge"]
    found = BridgeFilter(lambda: ids)
    assert found.accepts(spec("odom"), "bridge")
    ids[:] = ["restarted"]
    assert found.accepts(spec("odom"), "restarted")


@pytest.mark.parametrize("name", ["pose", "cmd_vel", "tf_static"])
def test_topics_that_others_send_too_and_latched_ones_are_never_filtered(name):
    found = BridgeFilter(lambda: ["bridge"])
    assert found.accepts(spec("odom"), "bridge")
    assert found.accepts(spec(name), "peer")
