"""Whether a message is signed by the holder of the lease. Pure functions."""

from bridge.gate.state import Lease
from rover_ncp.core.errors import FormatError
from rover_ncp.core.protocol import CommandTag, Signed

UNREADABLE_TAG = CommandTag(0, 0, 0)
"""In place of an attachment that is no tag: no lease has the number 0, so it is valid under none."""


def read_tag(attachment: bytes | None) -> CommandTag | None:
    """Return the tag of a message; None only without an attachment."""
    if attachment is None:
        return None
    try:
        return CommandTag.unpack(attachment)
    except FormatError:
        return UNREADABLE_TAG


def is_signed(
    tag: CommandTag | None, lease: Lease | None, kind: Signed, key_expr: str, payload: bytes
) -> bool:
    """Return whether a message's digest is valid under the key of the lease that is held."""
    if tag is None or lease is None or lease.secret is None or tag.lease != lease.number:
        return False
    return tag.verify(lease.secret, kind, key_expr, payload)
