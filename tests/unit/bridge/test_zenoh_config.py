"""Settings of the bridge's Zenoh session: what it refuses before it opens one."""

import base64
import json
import re

import pytest
from cryptography import x509

from bridge.zenoh.certificate_authority import make_credentials
from bridge.zenoh.config import configured
from rover_ncp.core.errors import FileError, UsageError


@pytest.fixture
def keys(tmp_path):
    def make(namespace):
        for name, text in make_credentials(["127.0.0.1"], namespace).items():
            (tmp_path / name).write_text(text)
        return tmp_path / "bridge.json5"

    return make


@pytest.mark.parametrize(("made", "asked"), [("bot1", "cmd_vel"), ("bot1", "bot2/cmd_vel")])
def test_keys_of_another_namespace_are_refused(keys, made, asked):
    found = f"{made}/cmd_vel".strip("/")
    words = f"no user publish {asked}, they are for {found}: .* same --namespace"
    with pytest.raises(FileError, match=words):
        configured(None, keys(made), False, asked)


@pytest.mark.parametrize(
    "host",
    ["192.168.1.20:7447", "tls/robot", "*.local", "röver.local"],
)
def test_host_that_no_address_can_match_is_refused(host):
    with pytest.raises(
        UsageError, match=f"^--host {re.escape(host)}: expected an IP address or an ASCII DNS"
    ):
        make_credentials([host])


@pytest.mark.parametrize("host", ["192.168.1.20", "[::1]", "Robot_1.local", "*.lab.example"])
def test_addresses_and_names_are_in_the_certificate(host):
    bridge = json.loads(make_credentials([host])["bridge.json5"].partition("\n")[2])
    pem = base64.b64decode(bridge["transport"]["link"]["tls"]["listen_certificate_base64"])
    names = x509.load_pem_x509_certificate(pem).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert [str(name.value) for name in names.value] == [host.strip("[]")]
