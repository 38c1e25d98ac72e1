"""Whether the certificates of a Zenoh configuration are valid now, by this computer's clock."""

import base64
import binascii
import json
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rover_ncp.core.errors import FileError

_TLS = "transport/link/tls"
_VERSION, _UTC_TIME = 0xA0, 0x17
_VALIDITY = 3
"""Its place in a certificate without version, after serial number, algorithm and issuer (RFC 5280)."""


def require_valid(settings: Any, role: str, file: Path | None, now: datetime) -> None:
    """Raise FileError if a certificate for a ``role``, "listen" or "connect", is not valid now.

    ``settings`` is a zenoh.Config. A certificate that cannot be read is left to Zenoh.
    """
    for name in (f"{role}_certificate", "root_ca_certificate"):
        for begin, end in map(validity, _certificates(settings, name)):
            if not begin <= now <= end:
                fault = "expired" if now > end else "not yet valid"
                raise FileError(
                    f"{file}: {name} is {fault}: it is valid from {begin:%Y-%m-%d} to {end:%Y-%m-%d}, and "
                    f"this computer's clock says {now:%Y-%m-%d %H:%M} UTC: set the clock, or make keys with "
                    "'rover-ncp keys'"
                )


def validity(pem: str) -> tuple[datetime, datetime]:
    """Return begin and end of a certificate's validity. Raises ValueError for what is none."""
    try:
        certificate = next(_elements(ssl.PEM_cert_to_DER_cert(pem)))[1]
        parts = [part for part in _elements(next(_elements(certificate))[1]) if part[0] != _VERSION]
        begin, end = (_time(tag, content) for tag, content in _elements(parts[_VALIDITY][1]))
    except (IndexError, StopIteration) as error:
        raise ValueError("not a certificate") from error
    return begin, end


def _certificates(settings: Any, name: str) -> Iterator[str]:
    """Yield the first certificate of a setting, a file or base64, if there is one that can be read."""
    path, encoded = (json.loads(settings.get_json(f"{_TLS}/{key}")) for key in (name, f"{name}_base64"))
    try:
        text = base64.b64decode(encoded).decode() if encoded else Path(path).read_text() if path else ""
        pem = text[text.index(ssl.PEM_HEADER) : text.index(ssl.PEM_FOOTER)] + ssl.PEM_FOOTER
        validity(pem)
    except (OSError, ValueError, binascii.Error):
        return
    yield pem


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield tag and content of each element of DER."""
    at = 0
    while at < len(data):
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(data[at : at + size]), at + size
        yield tag, data[at : at + length]
        at += length


def _time(tag: int, content: bytes) -> datetime:
    text = content.decode()
    century = ("19" if text >= "50" else "20") if tag == _UTC_TIME else ""
    return datetime.strptime(century + text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)
