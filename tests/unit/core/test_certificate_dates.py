"""Certificates of a Zenoh configuration: their validity is read, and judged by the clock."""

import re
import sys
from datetime import UTC, datetime, timedelta

import pytest
import zenoh

from bridge.zenoh.certificate_authority import make_credentials
from rover_ncp.core.errors import FileError
from rover_ncp.wire.certificate_dates import require_valid

NOW = datetime.now(UTC)


@pytest.fixture(scope="module")
def files():
    return make_credentials(["127.0.0.1"])


@pytest.mark.parametrize(("file", "role"), [("bridge.json5", "listen"), ("driver.json5", "connect")])
@pytest.mark.parametrize(
    ("now", "words"),
    [
        (datetime.fromtimestamp(0, UTC), "is not yet valid.*clock says 1970-01-01 00:00 UTC: set the clock"),
        (NOW - timedelta(days=3), "is not yet valid"),
        (NOW + timedelta(days=5 * 365 + 1), "is expired"),
    ],
)
def test_certificate_is_accepted_while_valid_and_else_refused_with_the_clock(files, file, role, now, words):
    config = zenoh.Config.from_json5(re.sub(r"^//.*\n", "", files[file]))
    require_valid(config, role, file, NOW)
    with pytest.raises(FileError, match=f"{role}_certificate {words}"):
        require_valid(config, role, file, now)


def test_without_the_library_tls_alone_judges_an_expired_certificate(files, monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    config = zenoh.Config.from_json5(re.sub(r"^//.*\n", "", files["bridge.json5"]))
    require_valid(config, "listen", None, NOW + timedelta(days=3000))
