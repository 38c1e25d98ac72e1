"""The bridge's Zenoh session: arrivals that it hands to the loop."""

from types import SimpleNamespace

import zenoh
from kit.bridge_bench import wait_for
from kit.zenoh_session import open_session

from bridge.inbox import Inbox
from bridge.ros2.rmw import Attachment
from bridge.ros2.ros_node import read_command
from bridge.zenoh.link import ZenohLink


def test_a_huge_command_reaches_the_loop_as_no_more_than_one_that_is_too_long():
    inbox = Inbox()
    with ZenohLink("tcp/127.0.0.1:0", "", None, inbox) as link:
        # A driver's own settings would drop what cannot leave at once.
        with open_session("client", {"connect/endpoints": [link.locator]}) as peer:
            publisher = peer.declare_publisher("cmd_vel")
            wait_for(lambda: publisher.matching_status.matching)
            publisher.put(bytes(400_000), attachment=bytes(400_000))
            (_, arrival), *_ = wait_for(lambda: inbox.take(0.1))
        assert len(arrival.payload) == 513
        assert len(arrival.attachment) == 41


def test_a_huge_command_of_a_ros_node_is_cut_too():
    attachment = zenoh.ZBytes(Attachment(1, 5, bytes(16)).pack())
    command = read_command(SimpleNamespace(payload=zenoh.ZBytes(bytes(900_000)), attachment=attachment))
    assert (len(command.payload), command.sent_ns) == (513, 5)
