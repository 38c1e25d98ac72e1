"""The key table and the namespace in front of it."""

import pytest

from rover_ncp.core.errors import UsageError
from rover_ncp.wire.key_table import KEYS, Kind, Role, key, spec


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [
        ("", "odom"),
        ("/", "odom"),
        ("bot1", "bot1/odom"),
        ("/bot1/", "bot1/odom"),
        ("lab/bot-1", "lab/bot-1/odom"),
    ],
)
def test_a_namespace_goes_in_front(namespace, expected):
    assert key(namespace, "odom") == expected


@pytest.mark.parametrize("namespace", ["a//b", "*", "a/**", "a b", "@ros", "a/$*", "a#b", "a?b", "ä", "a\n"])
def test_namespace_with_reserved_characters_is_rejected(namespace):
    with pytest.raises(UsageError, match="namespace"):
        key(namespace, "odom")


def test_only_driver_commands_and_only_bridge_reports():
    assert len({row.name for row in KEYS}) == len(KEYS)
    assert spec("cmd_vel").senders == {Role.DRIVER}
    for row in KEYS:
        assert row.senders
        assert row.receivers
        if row.kind is Kind.QUERYABLE:
            assert row.receivers == {Role.BRIDGE}
            assert Role.VIEWER not in row.senders
    for name in ("odom", "rover/cmd_out", "rover/gate", "rover/alive/bridge"):
        assert spec(name).senders == {Role.BRIDGE}
