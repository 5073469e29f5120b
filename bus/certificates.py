"""Authorities of runs, and the certificates that they issue, by `cryptography` (extra [tls]).

Its import raises `BusError` without the extra, so other modules import it only if certificates are used. A vehicle's
certificate is valid only for a client, and the router's only for a server: no party can impersonate the router.
"""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

from bus.errors import AccessDenied, BusError
from bus.identities import AUTHORITY_DAYS, PARTY_DAYS, RENEW, Authority, Identity, day_text
from bus.plugins import needs

with needs("tls", kind=BusError):
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
        load_pem_private_key,
    )
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

_CLOCK_TOLERANCE = timedelta(days=1)
"""Start of validity before the time of creation, for clocks that differ."""


def _read(text: str, what: str) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(text.encode())
    except ValueError as error:
        raise AccessDenied(f"{what}: not a certificate in PEM") from error


def _read_key(text: str, what: str) -> ec.EllipticCurvePrivateKey:
    try:
        key = load_pem_private_key(text.encode(), None)
    except (ValueError, TypeError) as error:
        raise AccessDenied(f"{what}: not a private key in PEM") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise AccessDenied(f"{what}: not a key of an elliptic curve")
    return key


def _pem(key: ec.EllipticCurvePrivateKey) -> str:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()


def _text(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(Encoding.PEM).decode()


def _unsigned(
    name: str, days: float, issuer: x509.Name | None = None
) -> tuple[ec.EllipticCurvePrivateKey, x509.CertificateBuilder]:
    """Return a new key and an unsigned certificate; without an issuer it is self-issued."""
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
    """Return a new authority for the certificates of one run; no certificate outlives it."""
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
    """
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


def _host(text: str) -> x509.GeneralName:
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
    """
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
            raise AccessDenied(
                f"{called} has expired on {day_text(part.not_valid_after_utc)}: {RENEW}"
            )
        if part.not_valid_before_utc > now:
            raise AccessDenied(
                f"{called} is not valid before {day_text(part.not_valid_before_utc)}: check this machine's clock"
            )
    return min(certificate.not_valid_after_utc, authority.not_valid_after_utc)
