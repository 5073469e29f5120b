"""Certificates for mutual TLS: an authority for each run, and one identity for each party.

Certificates are made and read by `cryptography` (extra [tls]), which is imported only if certificates are used. A
vehicle's certificate is valid only for a client, and the router's only for a server: no party can impersonate the
router.
"""

import ssl
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from socket import create_connection
from typing import TYPE_CHECKING

import msgspec

from bus.errors import AccessDenied, BusError
from bus.plugins import needs

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

ROUTER_HOSTS = ("localhost", "127.0.0.1", "::1", "router")
"""Default names of a router; `router` is its name among containers."""
AUTHORITY_DAYS = 3650
PARTY_DAYS = 365
"""Lifetime of certificates [days]. A router's certificate lasts as long as its authority, so that a renewal does not
stop the router.
"""
WARNED_DAYS = 30
"""Time before expiry at which a warning is logged [days]."""
_CLOCK_TOLERANCE = timedelta(days=1)
"""Start of validity before the time of creation, for clocks that differ."""
_REPLY_TIMEOUT = 2.0
"""Time limit for a router to report its objection to a certificate [s]."""


class Identity(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One party's certificate and key, and the authority that it trusts; all in PEM."""

    authority: str
    certificate: str
    key: str

    def __repr__(self) -> str:
        """Omit the key: it must not appear in a log."""
        return "Identity(...)"


class Authority(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Authority that signs a run's certificates. Only the owner of the run holds it, no process."""

    run: str
    certificate: str
    key: str

    def __repr__(self) -> str:
        """Omit the key: it must not appear in a log."""
        return f"Authority(run={self.run!r})"


def _need() -> None:
    with needs("tls", kind=BusError):
        import cryptography  # noqa: F401, PLC0415


def _read(text: str, what: str) -> "x509.Certificate":
    from cryptography import x509  # noqa: PLC0415

    try:
        return x509.load_pem_x509_certificate(text.encode())
    except ValueError as error:
        raise AccessDenied(f"{what}: not a certificate in PEM") from error


def _read_key(text: str, what: str) -> "ec.EllipticCurvePrivateKey":
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

    try:
        key = load_pem_private_key(text.encode(), None)
    except (ValueError, TypeError) as error:
        raise AccessDenied(f"{what}: not a private key in PEM") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise AccessDenied(f"{what}: not a key of an elliptic curve")
    return key


def _pem(key: "ec.EllipticCurvePrivateKey") -> str:
    from cryptography.hazmat.primitives import serialization as form  # noqa: PLC0415

    return key.private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()
    ).decode()


def _text(certificate: "x509.Certificate") -> str:
    from cryptography.hazmat.primitives.serialization import Encoding  # noqa: PLC0415

    return certificate.public_bytes(Encoding.PEM).decode()


def _unsigned(
    name: str, days: float, issuer: "x509.Name | None" = None
) -> "tuple[ec.EllipticCurvePrivateKey, x509.CertificateBuilder]":
    """Return a new key and an unsigned certificate; without an issuer it is self-issued."""
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric import ec  # noqa: PLC0415
    from cryptography.x509.oid import NameOID  # noqa: PLC0415

    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject if issuer is None else issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_TOLERANCE)
        .not_valid_after(now + timedelta(days=days))
    )
    return key, builder


def new_authority(run: str) -> Authority:
    """Return a new authority for the certificates of one run; no certificate outlives it.

    Raises:
        BusError: If the extra [tls] is missing.
    """
    _need()
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415

    serial = f"{x509.random_serial_number():x}"[:8]  # distinguishes two authorities of one run
    key, builder = _unsigned(f"Outrider {run} {serial}"[:64], AUTHORITY_DAYS)
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
    made = builder.add_extension(
        x509.BasicConstraints(ca=True, path_length=0), critical=True
    ).add_extension(usage, critical=True)
    return Authority(run=run, certificate=_text(made.sign(key, hashes.SHA256())), key=_pem(key))


def issue(
    authority: Authority, name: str, *, days: float = PARTY_DAYS, hosts: Sequence[str] = ()
) -> Identity:
    """Issue a certificate for a new key.

    Args:
        authority: Authority that signs the certificate.
        name: Common name, by which access control identifies the party.
        days: Lifetime [days]; at most the remaining lifetime of the authority.
        hosts: Names and addresses of the router; none: a client's certificate.

    Raises:
        AccessDenied: If the authority cannot be read, or has expired.
        BusError: If the extra [tls] is missing.
    """
    _need()
    from cryptography import x509  # noqa: PLC0415
    from cryptography.hazmat.primitives import hashes  # noqa: PLC0415
    from cryptography.x509.oid import ExtendedKeyUsageOID  # noqa: PLC0415

    issuer = _read(authority.certificate, "the authority")
    signing = _read_key(authority.key, "the authority")
    left = (issuer.not_valid_after_utc - datetime.now(UTC)) / timedelta(days=1)
    if left <= 0.0:
        raise AccessDenied(
            f"the authority has expired on {issuer.not_valid_after_utc:%Y-%m-%d}: create all credentials again"
        )
    key, builder = _unsigned(name, min(days, left), issuer.subject)
    purpose = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = builder.add_extension(
        x509.BasicConstraints(ca=False, path_length=None), critical=True
    ).add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
    if hosts:
        builder = builder.add_extension(
            x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False
        )
    made = builder.sign(signing, hashes.SHA256())
    return Identity(authority=authority.certificate, certificate=_text(made), key=_pem(key))


def _host(text: str) -> "x509.GeneralName":
    from cryptography import x509  # noqa: PLC0415

    try:
        return x509.IPAddress(ip_address(text))
    except ValueError:
        pass
    try:
        return x509.DNSName(text)
    except ValueError as error:
        raise AccessDenied(f"host {text!r}: neither a name nor an address") from error


def hosts_of(identity: Identity) -> tuple[str, ...]:
    """Return the names and addresses of a router's certificate; none for a client's.

    Raises:
        AccessDenied: If the certificate cannot be read.
    """
    _need()
    from cryptography import x509  # noqa: PLC0415

    certificate = _read(identity.certificate, "the certificate")
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return tuple(str(name.value) for name in found)


def check_identity(identity: Identity, name: str) -> datetime:
    """Check a certificate that a router or client would reject with a less helpful error.

    Args:
        identity: Identity to check.
        name: Name of its owner.

    Returns:
        Expiry of the certificate or of its authority, whichever is earlier.

    Raises:
        AccessDenied: If it cannot be read, belongs to another party, has expired, or its parts do not match.
        BusError: If the extra [tls] is missing.
    """
    _need()
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415
    from cryptography.x509.oid import NameOID  # noqa: PLC0415

    what = f"the certificate of {name}"
    certificate = _read(identity.certificate, what)
    authority = _read(identity.authority, f"the authority of {name}")
    names = [
        str(part.value) for part in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    ]
    if names != [name]:
        raise AccessDenied(f"{what} is for {' and '.join(names) or 'no party'}")
    if _read_key(identity.key, f"the key of {name}").public_key() != certificate.public_key():
        raise AccessDenied(f"{what} and its key do not match")
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise AccessDenied(
            f"{what} was issued by another authority than the one in its file"
        ) from error
    now = datetime.now(UTC)
    for part, called in ((certificate, what), (authority, f"the authority of {name}")):
        if part.not_valid_after_utc <= now:
            raise AccessDenied(f"{called} has expired on {_day(part.not_valid_after_utc)}: {RENEW}")
        if part.not_valid_before_utc > now:
            raise AccessDenied(
                f"{called} is not valid before {_day(part.not_valid_before_utc)}: check this machine's clock"
            )
    return min(certificate.not_valid_after_utc, authority.not_valid_after_utc)


RENEW = "`outrider credentials FOLDER --renew` makes a new one"


def _day(when: datetime) -> str:
    return f"{when:%Y-%m-%d %H:%M} UTC"


def expiry_warning(name: str, end: datetime) -> str:
    """Return a warning if the certificate ends within `WARNED_DAYS`; else an empty text."""
    days = (end - datetime.now(UTC)) / timedelta(days=1)
    if days >= WARNED_DAYS:
        return ""
    return f"the certificate of {name} expires in {days:.0f} days, on {_day(end)}: {RENEW}"


_REASONS = {
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "requires a certificate",
    "TLSV1_ALERT_UNKNOWN_CA": "does not trust the authority of this certificate: create both with the same "
    "`outrider credentials`",
    "TLSV1_ALERT_DECRYPT_ERROR": "does not trust the authority of this certificate: create both with the same "
    "`outrider credentials`",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": f"says that this certificate has expired: {RENEW}",
    "SSLV3_ALERT_UNSUPPORTED_CERTIFICATE": "says that this certificate is not for a client",
    "WRONG_VERSION_NUMBER": "does not speak TLS",
}
_UNVERIFIED = {
    "unable to get local issuer certificate": "was issued by another authority than this process' own: create "
    "both with the same `outrider credentials`",
    "certificate signature failure": "was issued by another authority than this process' own",
    "certificate has expired": "has expired: renew it and restart the router",
    "certificate is not yet valid": "is not valid yet: check this machine's clock",
    "unsuitable certificate purpose": "is not a router's: another party listens at this endpoint",
}


def find_fault(host: str, port: int, identity: Identity) -> str:
    """Return why a router rejects an identity, or an identity the router; Zenoh does not report the reason.

    Args:
        host: Host of the router.
        port: Port of the router.
        identity: Identity of the client.

    Returns:
        Predicate of a sentence about the router; empty if TLS raises no objection.

    Raises:
        OSError: If no process answers there.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cadata=identity.authority)
    with tempfile.TemporaryDirectory(prefix="outrider-") as folder:
        path = Path(folder) / "identity.pem"  # the folder is private and removed at once
        path.write_text(identity.certificate + identity.key, encoding="ascii")
        context.load_cert_chain(path)
    try:
        with (
            create_connection((host, port), _REPLY_TIMEOUT) as plain,
            context.wrap_socket(plain, server_hostname=host) as opened,
        ):
            opened.settimeout(_REPLY_TIMEOUT)
            opened.read(1)  # the router's objection arrives after the handshake
    except ssl.SSLCertVerificationError as error:
        message = error.verify_message
        if "mismatch" in message:
            remedy = "add it with `outrider credentials --tls --router HOST`"
            return f"has a certificate that is not for {host!r}: {remedy}"
        return (
            f"has a certificate that {_UNVERIFIED.get(message, f'cannot be verified: {message}')}"
        )
    except ssl.SSLError as error:
        reason = error.reason or str(error)
        return _REASONS.get(
            reason, f"refuses this certificate ({reason.lower().replace('_', ' ')})"
        )
    except TimeoutError:
        pass
    return ""
