"""Identities for mutual TLS: a certificate and key of each party, and the objections of a router to them.

They are made and read by `bus.certificates`.
"""

import ssl
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from socket import create_connection

import msgspec

ROUTER_HOSTS = ("localhost", "127.0.0.1", "::1", "router")
"""Default names of a router; `router` is its name among containers."""
AUTHORITY_DAYS = 3650
PARTY_DAYS = 365
"""Lifetime of certificates [days]. A router's certificate lasts as long as its authority, so that a renewal does not
stop the router.
"""
WARNED_DAYS = 30
"""Time before expiry at which a warning is logged [days]."""
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


RENEW = "`outrider credentials FOLDER --renew` makes a new one"
"""Remedy for an expired certificate."""


def day_text(when: datetime) -> str:
    """Return a time in UTC, to the minute."""
    return f"{when:%Y-%m-%d %H:%M} UTC"


def expiry_warning(name: str, end: datetime) -> str:
    """Return a warning if the certificate ends within `WARNED_DAYS`; else an empty text."""
    days = (end - datetime.now(UTC)) / timedelta(days=1)
    if days >= WARNED_DAYS:
        return ""
    return f"the certificate of {name} expires in {days:.0f} days, on {day_text(end)}: {RENEW}"


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
