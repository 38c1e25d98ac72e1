"""The key table and the namespace in front of it."""

import pytest

from rover_ncp.core.errors import UsageError
from rover_ncp.wire.key_table import key


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [
        ("", "odom"),
        ("bot1", "bot1/odom"),
        ("/bot1/", "bot1/odom"),
    ],
)
def test_a_namespace_goes_in_front(namespace, expected):
    assert key(namespace, "odom") == expected


@pytest.mark.parametrize("namespace", ["a//b", "a/**", "a b", "@ros", "a#b", "ä"])
def test_namespace_with_reserved_characters_is_rejected(namespace):
    with pytest.raises(UsageError, match="namespace"):
        key(namespace, "odom")
