"""Permission to stop, between real processes with the keys of ``rover-ncp keys``."""

import pytest
from bridge_bench import Rig, wait_for

from deploy.watch.viewer import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NoBridge, NotAuthorised
from rover_ncp.core.messages import read_text
from rover_ncp.core.protocol import GateStatus, parse_json


def gates(heard):
    return [parse_json(GateStatus, read_text(m.data)) for m in heard if m.topic == "rover/gate"]


def test_a_viewer_receives_everything_and_stops_nothing(secured, keys):
    heard = []
    with Viewer(BridgeAddress(secured.locator, "", keys / "viewer.json5"), heard.append) as viewer:
        wait_for(lambda: {"odom", "rover/gate", "tf"} <= {message.topic for message in heard})
        assert viewer.bridge_alive
        assert viewer.may_stop is False
        with pytest.raises(NotAuthorised, match="not authorised to stop"):
            viewer.stop()
        count = len(gates(heard))
        wait_for(lambda: len(gates(heard)) > count + 2)
        assert gates(heard)[-1].held != "stopped"


def test_who_may_drive_may_stop_and_release(secured, keys):
    heard = []
    with Viewer(BridgeAddress(secured.locator, "", keys / "driver.json5"), heard.append) as viewer:
        wait_for(lambda: viewer.may_stop)
        assert viewer.stop().stopped is True
        wait_for(lambda: gates(heard) and gates(heard)[-1].held == "stopped")
        assert gates(heard)[-1].stop_reason == "the Stop button of a viewer"
        assert viewer.stop(release=True).stopped is False
        wait_for(lambda: gates(heard)[-1].held != "stopped")


def test_the_end_of_the_bridge_is_noticed(tmp_path):
    with Rig(tmp_path) as rig, Viewer(BridgeAddress(rig.locator), lambda message: None) as viewer:
        wait_for(lambda: viewer.bridge_alive and viewer.may_stop)
        rig.bridge.stop()
        wait_for(lambda: not viewer.bridge_alive and not viewer.may_stop)
        with pytest.raises(NoBridge):
            viewer.stop()


def test_no_bridge_is_an_error_with_its_address():
    with pytest.raises(NoBridge, match="nothing answers"):
        Viewer(BridgeAddress("tcp/127.0.0.1:9"), lambda message: None)
