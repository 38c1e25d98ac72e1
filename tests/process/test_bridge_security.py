"""A bridge with the keys of ``rover-ncp keys``: its access rules, and that Zenoh obeys them over TLS."""

import base64
import json
import re

import pytest
import zenoh
from kit.bridge_bench import Driver, wait_for
from kit.zenoh_session import open_router

from bridge.zenoh.certificate_authority import access_control
from deploy.view.server import Viewer
from deploy.zenoh_client import BridgeAddress
from rover_ncp import cli
from rover_ncp.core.errors import FormatError, NotAuthorised
from rover_ncp.wire.key_table import KEYS, Kind, Role
from rover_ncp.wire.protocol import Signed
from rover_ncp.wire.zenoh import client_config

HEARD = [row.name for row in KEYS if row.kind is Kind.MESSAGE and row.senders == {Role.BRIDGE}]
SELDOM = {"sonar", "imu", "docked"}
"""Only where something is near, from a base with a gyro, and from a ROS 2 robot."""


def read(path):
    return json.loads(re.sub(r"^//.*\n", "", path.read_text()))


class User(Driver):
    """A session with a configuration of its own."""

    keys = tuple(HEARD)

    def heard_again(self, *names):
        """Wait until each of these messages has come anew."""
        self.seen.clear()
        wait_for(lambda: {*names} <= self.seen.keys())

    def tokens(self, name):
        return len(list(self.session.liveliness().get(name, timeout=1.0)))


def test_a_driver_sees_everything_and_drives(secured, keys):
    with User(secured.robot, config=keys / "driver.json5") as driver:
        wait_for(lambda: driver.may_drive and {*HEARD} - SELDOM <= driver.seen.keys())
        wait_for(lambda: driver.motors().granted)
        wait_for(lambda: driver.send() and driver.gate.accepted > 0)
        wait_for(lambda: driver.gate.lease == 0)  # it fell silent


def test_viewer_receives_everything_and_cannot_drive(secured, keys):
    with User(secured.robot, config=keys / "viewer.json5") as viewer:
        wait_for(lambda: {*HEARD} - SELDOM <= viewer.seen.keys())
        before = viewer.gate
        for name in ("cmd_vel", "*", "**", "cmd_$*", "cmd_vel/**"):
            viewer.session.put(name, b"", attachment=viewer.tag(Signed.COMMAND, name, b""))
        assert not viewer.may_drive
        with pytest.raises(FormatError, match="0 answers"):
            viewer.motors()
        for name in ("rover/stop", "rover/base", "rover/*", "**"):
            replies = viewer.session.get(name, payload=b"{}", timeout=0.5)
            assert [reply for reply in replies if reply.ok and str(reply.ok.key_expr) in HEARD] == []
            assert [reply for reply in replies if reply.ok] == []
        viewer.heard_again("rover/gate")
        after = viewer.gate
    assert (after.accepted, after.dropped, after.lease) == (before.accepted, before.dropped, before.lease)
    assert after.stop_reason == ""
    with Viewer(BridgeAddress(secured.robot, "", keys / "viewer.json5"), lambda message: None) as viewer:
        wait_for(lambda: viewer.bridge_alive)
        assert viewer.may_stop is False
        with pytest.raises(NotAuthorised, match="not authorised to stop"):
            viewer.stop()


def test_no_client_can_publish_or_answer_for_the_bridge(secured, keys):
    with (
        User(secured.robot, config=keys / "driver.json5") as driver,
        User(secured.robot, config=keys / "viewer.json5") as viewer,
    ):
        wait_for(lambda: "rover/gate" in viewer.seen and driver.may_drive)
        token = driver.session.liveliness().declare_token("rover/alive/bridge")
        own = driver.session.liveliness().declare_token("rover/alive/driver")
        for name in ("odom", "rover/gate", "rover/*", "**"):
            driver.session.put(name, b"forged")
        wait_for(lambda: viewer.tokens("rover/alive/driver") == 1)
        assert viewer.tokens("rover/alive/bridge") == 1
        viewer.heard_again("odom", "rover/gate")
        assert b"forged" not in viewer.seen.values()
        token.undeclare()
        own.undeclare()
        assert viewer.tokens("rover/alive/bridge") == 1


def refused(locator, config):
    """Whether a client is refused, which tries for half a second."""
    settings, _ = client_config(locator, config)
    settings.insert_json5("connect/timeout_ms", "500")
    try:
        zenoh.open(settings).close()
    except zenoh.ZError:
        return True
    return False


@pytest.mark.parametrize("stranger", ["of another lab", "without a certificate"])
def test_a_stranger_cannot_connect(secured, keys, tmp_path, stranger):
    assert not refused(secured.robot, keys / "driver.json5")
    ours = read(keys / "driver.json5")["transport"]["link"]["tls"]
    assert cli.run(["keys", "--out", str(tmp_path)]) == 0
    tls = read(tmp_path / "driver.json5")["transport"]["link"]["tls"]
    tls["root_ca_certificate_base64"] = ours["root_ca_certificate_base64"]
    if stranger == "without a certificate":
        tls = {name: value for name, value in tls.items() if not name.startswith("connect_")}
    config = tmp_path / "zenoh.json5"
    config.write_text(json.dumps({"transport": {"link": {"protocols": ["tls"], "tls": tls}}}))
    assert refused(secured.robot, config)


def test_drivers_certificate_is_not_valid_for_listening(keys):
    def listens(end, verb):
        tls = read(keys / f"{end}.json5")["transport"]["link"]["tls"]
        for name in ("certificate", "private_key"):
            tls[f"listen_{name}_base64"] = tls[f"{verb}_{name}_base64"]
        impostor, locator = open_router("tls", **{"transport/link/tls": tls})
        with impostor:
            return not refused(locator, keys / "driver.json5")

    assert listens("bridge", "listen")
    assert not listens("driver", "connect")


def test_files_that_hold_secrets_are_their_owners_alone_and_never_replaced(keys, capsys):
    modes = {path.name: path.stat().st_mode & 0o777 for path in keys.iterdir()}
    assert modes.pop("ca.pem") & 0o077 != 0
    assert set(modes.values()) == {0o600}
    before = (keys / "driver.json5").read_bytes()
    assert cli.run(["keys", "--out", str(keys)]) == 2
    assert "holds keys already" in capsys.readouterr().err
    assert (keys / "driver.json5").read_bytes() == before
    tls = read(keys / "bridge.json5")["transport"]["link"]["tls"]
    assert base64.b64decode(tls["listen_certificate_base64"]).startswith(b"-----BEGIN CERTIFICATE")


def test_each_right_follows_from_the_table_of_keys():
    control = access_control("bot1")
    assert control["default_permission"] == "deny"
    allowed = {
        (policy["subjects"][0], flow, message, key)
        for policy in control["policies"]
        for rule in control["rules"]
        if rule["id"] in policy["rules"]
        for flow in rule["flows"]
        for message in rule["messages"]
        for key in rule["key_exprs"]
    }
    assert {item for item in allowed if "*" in item[3] or not item[3].startswith("bot1/")} == set()
    ingress = {(who, key) for who, flow, message, key in allowed if (flow, message) == ("ingress", "put")}
    assert {key for who, key in ingress if who == "viewer"} == set()
    view = {"bot1/tag_view/compressed", "bot1/tag_view/annotations"}
    localiser = {"bot1/pose", "bot1/rover/localiser", *view}
    assert {key for who, key in ingress if who == "localiser"} == localiser
    assert {key for who, key in ingress if who == "driver"} == localiser | {
        f"bot1/{name}" for name in ("cmd_vel", "rover/estimate", "rover/neurons", "rover/status")
    }
    assert {(who, key) for who, flow, message, key in allowed if (flow, message) == ("ingress", "query")} == {
        ("driver", f"bot1/rover/{name}") for name in ("motors", "stop", "base")
    }
    tokens = {(who, key) for who, flow, m, key in allowed if (flow, m) == ("ingress", "liveliness_token")}
    assert tokens == {("driver", "bot1/rover/alive/driver")}
