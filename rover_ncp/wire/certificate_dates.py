"""Whether the certificates of a Zenoh configuration are valid now, by this computer's clock.

The library ``cryptography`` of the extra ``drive`` reads them. Without it TLS alone rejects an invalid one.
"""

import base64
import binascii
import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import read_bytes

_TLS = "transport/link/tls"


def require_valid(settings: Any, role: str, file: Path | None, now: datetime) -> None:
    """Raise FileError if a certificate for a ``role``, "listen" or "connect", is not valid now.

    ``settings`` is a zenoh.Config. A certificate that cannot be read is left to Zenoh.
    """
    for name in (f"{role}_certificate", "root_ca_certificate"):
        for begin, end in _validity(settings, name):
            if not begin <= now <= end:
                fault = "expired" if now > end else "not yet valid"
                raise FileError(
                    f"{file}: {name} is {fault}: it is valid from {begin:%Y-%m-%d} to {end:%Y-%m-%d}, and "
                    f"this computer's clock says {now:%Y-%m-%d %H:%M} UTC: set the clock, or make keys with "
                    "'rover-ncp keys'"
                )


def _validity(settings: Any, name: str) -> Iterator[tuple[datetime, datetime]]:
    """Yield begin and end of the first certificate of a setting (a file or base64) that can be read."""
    path, encoded = (json.loads(settings.get_json(f"{_TLS}/{key}")) for key in (name, f"{name}_base64"))
    if not path and not encoded:
        return
    try:
        from cryptography import x509

        pem = base64.b64decode(encoded) if encoded else read_bytes(Path(path))
        certificate = x509.load_pem_x509_certificate(pem)
    except (ImportError, FileError, ValueError, binascii.Error):
        return
    yield certificate.not_valid_before_utc, certificate.not_valid_after_utc
