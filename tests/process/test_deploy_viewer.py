"""Permission to stop, between real processes with the keys of ``rover-ncp keys``."""

import pytest
from kit.bridge_bench import wait_for

from deploy.view.viewer import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.core.errors import NotAuthorised
from rover_ncp.wire.messages import read_text
from rover_ncp.wire.protocol import GateStatus, parse_json


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
