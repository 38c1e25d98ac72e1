"""A peer that answers queries in the bridge's place: mock and bridge as real processes."""

import time

import pytest
from kit.bridge_bench import Rig, client, wait_for

from deploy.drive.zenoh_link import ZenohLink
from deploy.view.server import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp.wire.protocol import BaseReply, StopReply, TimeoutState, dump_json

FALSE = {
    "rover/stop": dump_json(StopReply(stopped=False, reason="false")),
    "rover/base": dump_json(BaseReply(model="false", state=TimeoutState.UNKNOWN)),
}


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    with Rig(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


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
                query.reply(name, FALSE[name] if request.param == "false" else b"{")

    session = client(rig.locator)
    queryables = [session.declare_queryable(name, answer) for name in FALSE]
    yield queryables
    session.close()


def test_only_the_bridges_answer_counts(rig, false_answerer):
    with Viewer(BridgeAddress(rig.locator), lambda message: None) as viewer:
        wait_for(lambda: viewer.may_stop)
        for release in (False, True) * 3:
            began_s = time.monotonic()
            assert viewer.stop(release).stopped is not release
            assert time.monotonic() - began_s < 0.9  # it waits for no other answer
    with ZenohLink(BridgeAddress(rig.locator), lambda message: None) as link:
        assert [link.about_base().model for _ in range(5)] == ["p3at-sh"] * 5
