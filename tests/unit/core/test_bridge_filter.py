"""Whose messages count on the topics that only a bridge sends."""

import pytest

from rover_ncp.wire.bridge_filter import BridgeFilter
from rover_ncp.wire.key_table import spec


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
