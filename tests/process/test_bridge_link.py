"""The bridge's Zenoh session: arrivals that it hands to the loop."""

from bridge_bench import client, wait_for

from bridge.inbox import Inbox
from bridge.zenoh_link import ZenohLink


def test_a_huge_command_reaches_the_loop_as_no_more_than_one_that_is_too_long():
    inbox = Inbox()
    with ZenohLink("tcp/127.0.0.1:0", "", None, inbox) as link, client(link.locator) as peer:
        publisher = peer.declare_publisher("cmd_vel")
        wait_for(lambda: publisher.matching_status.matching)
        publisher.put(bytes(900_000))
        (_, arrival), *_ = wait_for(lambda: inbox.take(0.1))
        assert len(arrival.payload) == 513
