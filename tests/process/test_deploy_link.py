"""The driver's link: it detects a slow link and the lease of another driver, and ends its callbacks."""

import threading
import time

import pytest
from kit.deploy_bench import Bridge

from deploy.drive.zenoh_link import REQUEST_TRIES, ROUND_TRIP_S, ZenohLink
from deploy.zenoh_client import BridgeAddress, ZenohClient
from rover_ncp.core.errors import SafetyStop


def request_motors(bridge, *delays):
    bridge.delays = list(delays)
    try:
        with ZenohLink(BridgeAddress(bridge.robot), lambda _: None) as link:
            return link.request_motors("test")
    finally:
        bridge.close()


def test_a_link_that_is_always_slow_refuses_the_drive():
    slow_s = ROUND_TRIP_S + 0.05
    message = r"stopped by slow-link: the bridge at tcp/127.* takes 0.[2-9]"
    with pytest.raises(SafetyStop, match=message) as stop:
        request_motors(Bridge(), *[slow_s] * REQUEST_TRIES)
    assert stop.value.exit_code == 4


def test_one_slow_answer_is_allowed_and_the_link_is_measured_again():
    bridge = Bridge()
    assert request_motors(bridge, ROUND_TRIP_S + 0.05).granted
    first, renewal, release = bridge.requests
    assert (first.enable, renewal.enable, release.enable) == (True, True, False)
    assert renewal.sent_ns > first.sent_ns


def test_no_callback_runs_after_close_and_none_is_left_to_abort_python():
    bridge, begun, ended = Bridge(), threading.Event(), threading.Event()

    def receive(_row, _data):
        begun.set()
        time.sleep(0.3)
        ended.set()

    def use():
        with ZenohClient(BridgeAddress(bridge.robot), receive):
            assert begun.wait(5.0)
            ended.clear()

    others = threading.enumerate()
    user = threading.Thread(target=use, daemon=True)
    user.start()
    user.join()
    assert ended.is_set()
    assert [thread for thread in threading.enumerate() if thread not in others] == []
    bridge.close()
