"""A lab's own certificate authority, and for each role a certificate, a password and a Zenoh configuration.

Every configuration is one file that holds all its end needs, to be copied to where it is used; only the
bridge has a second beside it, with the users' passwords, for Zenoh reads those from a file.
"""

import base64
import datetime
import ipaddress
import json
import secrets
from collections.abc import Mapping, Sequence
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rover_ncp.core.access_control import access_control
from rover_ncp.core.key_table import Role

PEERS = (Role.DRIVER, Role.VIEWER, Role.LOCALISER)
"""Roles that get a user of the bridge."""
USERS_FILE = "users.txt"

_VALID = datetime.timedelta(days=5 * 365)
_BACKDATED = datetime.timedelta(days=2)
"""A robot's clock may be wrong by a time zone, or a battery's sleep."""
_LISTEN = "tls/0.0.0.0:7447"


def make_credentials(hosts: Sequence[str], namespace: str = "") -> Mapping[str, str]:
    """Return the files by name: new keys at each call. ``hosts`` are the bridge's names and IP addresses.

    Raises UsageError for a namespace that is no key.
    """
    control = access_control(PEERS, namespace)
    authority, authority_key = _authority()
    passwords = {role: secrets.token_urlsafe(24) for role in (Role.BRIDGE, *PEERS)}

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
        return {
            "link": {"protocols": ["tls"], "tls": tls},
            "auth": {"usrpwd": {"user": role.value, "password": passwords[role]}},
        }

    transport = end(Role.BRIDGE, listens=True)
    transport["auth"]["usrpwd"]["dictionary_file"] = USERS_FILE
    bridge = {"listen": {"endpoints": [_LISTEN]}, "transport": transport, "access_control": control}
    users = "".join(f"{role.value}:{passwords[role]}\n" for role in PEERS)
    return {
        "ca.pem": _pem(authority),
        "ca-key.pem": _private(authority_key),
        "bridge.json5": _json5(bridge, "rover-ncp bridge --zenoh-config, beside users.txt"),
        USERS_FILE: users,
        **{
            f"{role.value}.json5": _json5({"transport": end(role, listens=False)}, f"a {role.value}")
            for role in PEERS
        },
    }


def _authority() -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    private = ec.generate_private_key(ec.SECP256R1())
    name = _name("rover-ncp lab")
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    builder = _builder(name, name, private).add_extension(x509.BasicConstraints(True, 0), critical=True)
    return builder.add_extension(usage, critical=True).sign(private, hashes.SHA256()), private


def _certificate(
    common_name: str,
    private: ec.EllipticCurvePrivateKey,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    hosts: Sequence[str],
) -> x509.Certificate:
    """Sign a certificate; with ``hosts`` it is one to listen with, without only one to connect with."""
    usage = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = (
        _builder(_name(common_name), authority.subject, private)
        .add_extension(x509.BasicConstraints(False, None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
    )
    if hosts:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        builder = builder.add_extension(names, critical=False)
    return builder.sign(authority_key, hashes.SHA256())


def _builder(
    subject: x509.Name, issuer: x509.Name, private: ec.EllipticCurvePrivateKey
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(private.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + _VALID)
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
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
