"""The driver's link: detection of a link that is too slow."""

import json
import time

import pytest
import zenoh

from deploy.drive.zenoh_link import REQUEST_TRIES, ROUND_TRIP_S, ZenohLink
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import OtherVersion, SafetyStop
from rover_ncp.core.protocol import CommandTag, MotorsReply, MotorsRequest, Signed, dump_json, parse_json

SECRET = bytes(range(32))


class SlowBridge:
    """Grants the motors after ``delays``, one for each request: the first with a key, later ones signed."""

    def __init__(self, *delays):
        self._delays, self.requests = list(delays), []
        config = zenoh.Config()
        for path, value in {
            "mode": "router",
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "scouting/multicast/enabled": False,
            "scouting/delay": 0,
            "adminspace/enabled": True,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self.session = zenoh.open(config)
        (reply,) = self.session.get(f"@/{self.session.info.zid()}/router", timeout=1.0)
        self.robot = json.loads(reply.ok.payload.to_string())["locators"][0]
        self._motors = self.session.declare_queryable("rover/motors", self._answer)

    def _answer(self, query):
        with query:
            request = parse_json(MotorsRequest, query.payload.to_bytes())
            self.requests.append(request)
            if query.attachment is None:
                reply = MotorsReply(granted=True, lease=3, key=SECRET.hex())
            else:
                tag, payload = CommandTag.unpack(query.attachment.to_bytes()), query.payload.to_bytes()
                signed = tag.lease == 3 and tag.verify(SECRET, Signed.MOTORS, "rover/motors", payload)
                reply = MotorsReply(granted=signed and request.enable, lease=3)
            if request.enable:
                time.sleep(self._delays.pop(0))
            query.reply("rover/motors", dump_json(reply))


@pytest.fixture
def ask():
    def ask(*delays):
        bridge = SlowBridge(*delays)
        try:
            with ZenohLink(BridgeAddress(bridge.robot), lambda _: None) as link:
                return link.request_motors("test"), bridge
        finally:
            bridge.session.close()

    return ask


def test_a_link_that_is_always_slow_refuses_the_drive(ask):
    late = ROUND_TRIP_S + 0.05
    with pytest.raises(
        SafetyStop, match=r"stopped by slow-link: the bridge at tcp/127.* takes 0.[2-9]"
    ) as stop:
        ask(*[late] * REQUEST_TRIES)
    assert stop.value.exit_code == 4


def test_a_link_may_be_slow_by_chance_and_is_measured_anew(ask):
    reply, bridge = ask(ROUND_TRIP_S + 0.05, 0.0)
    assert reply.granted
    enabling = [request for request in bridge.requests if request.enable]
    assert len(enabling) == 2
    assert bridge.requests[-1].enable is False  # given back at the end
    assert enabling[1].sent_ns > enabling[0].sent_ns


class OldBridge(SlowBridge):
    """Answers as a bridge of protocol version 1 does to a request that it cannot read."""

    def _answer(self, query):
        with query:
            query.reply_err("MotorsRequest: driver: Field required")


def test_a_bridge_of_an_older_version_is_named_with_our_own():
    bridge = OldBridge()
    try:
        with (
            ZenohLink(BridgeAddress(bridge.robot), lambda _: None) as link,
            pytest.raises(
                OtherVersion, match="the bridge uses protocol version 1, the driver version 2"
            ) as error,
        ):
            link.request_motors("test")
    finally:
        bridge.session.close()
    assert error.value.exit_code == 3
    assert "\n" not in str(error.value)
