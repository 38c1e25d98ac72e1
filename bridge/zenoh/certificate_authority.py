"""A lab's own certificate authority, and for each role a certificate and a Zenoh configuration.

Every configuration is one file that holds all its end needs, to be copied to where it is used.

The rights of each role are made from the table of keys. Zenoh matches rules by inclusion only, so nothing but
a deny by default with exact keys holds: with an allow by default, a message on ``rover/*`` would slip past a
rule that denies ``rover/motors``. Rules apply at the links of the bridge's router; what its own session does
is not filtered.
"""

import base64
import datetime
import ipaddress
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from pydantic import BaseModel, Field

from rover_ncp.core.errors import UsageError
from rover_ncp.wire.key_table import KEYS, Kind, Role, key


class KeysResult(BaseModel):
    """Result of the command ``keys``."""

    folder: str = Field(description="where the files are")
    files: list[str] = Field(description="the files that were written")
    hosts: list[str] = Field(description="names and addresses of the bridge in its certificate")
    namespace: str = Field(description="before all keys")


PEERS = (Role.DRIVER, Role.VIEWER, Role.LOCALISER)
"""Roles that get a certificate to connect with."""

# (flow seen from the bridge's router, kinds of Zenoh messages) for a peer that sends, and one that receives.
# A peer detects a listener only where the listener's declaration may leave the router. That is how a
# driver checks whether it may drive before it tries.
_SENDS = {
    Kind.MESSAGE: (("ingress", ("put",)), ("egress", ("declare_subscriber",))),
    Kind.QUERYABLE: (("ingress", ("query",)), ("egress", ("reply", "declare_queryable"))),
    Kind.TOKEN: (("ingress", ("liveliness_token",)),),
}
_RECEIVES = {
    Kind.MESSAGE: (("egress", ("put",)), ("ingress", ("declare_subscriber",))),
    Kind.QUERYABLE: (),  # only the bridge answers, and it is no peer of its own router
    Kind.TOKEN: (
        ("egress", ("liveliness_token",)),
        ("ingress", ("declare_liveliness_subscriber", "liveliness_query")),
    ),
}

_VALID = datetime.timedelta(days=5 * 365)
_BACKDATED = datetime.timedelta(days=2)
"""A robot's clock may be wrong by a time zone, or a battery's sleep."""
_LISTEN = "tls/0.0.0.0:7447"
_MAX_DNS_NAME = 253
_DNS_NAME = re.compile(r"(?:\*\.[\w-]{1,63}\.)?(?:[\w-]{1,63}\.)*(?!\d+\Z)[\w-]{1,63}", re.ASCII)
"""What checks of certificates match: at least two labels after ``*``, and a last label that is no number."""


_OF_AN_AUTHORITY = ("key_cert_sign", "crl_sign")
_USAGES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"),
    *("encipher_only", "decipher_only"),
)


def make_credentials(hosts: Sequence[str], namespace: str = "") -> Mapping[str, str]:
    """Return the files by name: new keys at each call. ``hosts`` are the bridge's names and IP addresses.

    Raises UsageError for a namespace that is no key and for an invalid host.
    """
    control = access_control(namespace)
    authority, authority_key = _authority()

    def end(role: Role, listens: bool) -> dict[str, Any]:
        """Return the ``transport`` of one end."""
        private = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(role.value, private, authority, authority_key, hosts if listens else ())
        verb = "listen" if listens else "connect"
        tls = {
            "root_ca_certificate_base64": _base64(_pem(authority)),
            f"{verb}_certificate_base64": _base64(_pem(certificate)),
            f"{verb}_private_key_base64": _base64(_private(private)),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
        if listens:
            tls["close_link_on_expiration"] = True
        return {"link": {"protocols": ["tls"], "tls": tls}}

    bridge = {
        "listen": {"endpoints": [_LISTEN]},
        "transport": end(Role.BRIDGE, listens=True),
        "access_control": control,
    }
    return {
        "ca.pem": _pem(authority),
        "ca-key.pem": _private(authority_key),
        "bridge.json5": _json5(bridge, "rover-ncp bridge --zenoh-config"),
        **{
            f"{role.value}.json5": _json5({"transport": end(role, listens=False)}, f"a {role.value}")
            for role in PEERS
        },
    }


def _authority() -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    private = ec.generate_private_key(ec.SECP256R1())
    usage = x509.KeyUsage(**dict.fromkeys(_USAGES, False) | dict.fromkeys(_OF_AN_AUTHORITY, True))
    builder = _builder("rover-ncp lab", private, ca=True).add_extension(usage, critical=True)
    return builder.issuer_name(_name("rover-ncp lab")).sign(private, hashes.SHA256()), private


def _certificate(
    common_name: str,
    private: ec.EllipticCurvePrivateKey,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    hosts: Sequence[str],
) -> x509.Certificate:
    """Sign a certificate; with ``hosts`` it is one to listen with, without only one to connect with."""
    usage = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = _builder(common_name, private, ca=False).issuer_name(authority.subject)
    builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    if hosts:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    return builder.sign(authority_key, hashes.SHA256())


def _builder(common_name: str, private: ec.EllipticCurvePrivateKey, *, ca: bool) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(_name(common_name))
        .public_key(private.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + _VALID)
        .add_extension(x509.BasicConstraints(ca, 0 if ca else None), critical=True)
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def is_host(host: str) -> bool:
    """Return whether the address of a driver can match this name in a certificate."""
    try:
        _host(host)
    except UsageError:
        return False
    return True


def _host(host: str) -> x509.GeneralName:
    """Return a name of a certificate. Raises UsageError for an invalid one."""
    with suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    if len(host) > _MAX_DNS_NAME or not _DNS_NAME.fullmatch(host):
        raise UsageError(
            f"--host {host}: expected an IP address or an ASCII DNS name without tls/ and port, such as "
            "192.168.1.20 or robot.local"
        )
    return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def _private(private: ec.EllipticCurvePrivateKey) -> str:
    return private.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()


def _base64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


def _json5(content: Mapping[str, Any], whose: str) -> str:
    return (
        f"// Zenoh configuration of {whose}. It holds a private key: who can read it can do the same.\n"
        + (json.dumps(content, indent=2) + "\n")
    )


def access_control(namespace: str) -> dict[str, Any]:
    """Return Zenoh's ``access_control``: each role, named in its certificate, gets its rows.

    Raises UsageError for a namespace that is no key.
    """
    rules = {role.value: _rules(role, namespace) for role in PEERS}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for of_role in rules.values() for rule in of_role],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in rules],
        "policies": [
            {"rules": [rule["id"] for rule in of_role], "subjects": [name]} for name, of_role in rules.items()
        ],
    }


def _rules(role: Role, namespace: str) -> list[dict[str, Any]]:
    allowed: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for row in KEYS:
        sends = _SENDS[row.kind] if role in row.senders else ()
        receives = _RECEIVES[row.kind] if role in row.receivers else ()
        for flow_and_messages in (*sends, *receives):
            allowed.setdefault(flow_and_messages, []).append(key(namespace, row.name))
    return [
        {
            "id": f"{role.value}-{flow}-{messages[0].replace('_', '-')}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": key_exprs,
        }
        for (flow, messages), key_exprs in allowed.items()
    ]
