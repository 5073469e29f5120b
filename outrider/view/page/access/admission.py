"""Before the page is served: the socket it is served on, and who may come in."""

import errno
import re
import secrets
import socket
from dataclasses import dataclass

from bus.errors import ScenarioError
from bus.locator import LOOPBACK


@dataclass(frozen=True, slots=True, kw_only=True)
class Admission:
    """The secrets that let a browser in; all empty: none, but it must be on this machine."""

    token: str = ""
    """Lets in any number of browsers; it is typed, and never part of an address."""
    ticket: str = ""
    """Lets in one browser, once, as part of the address: histories keep addresses. Empty: there is none."""


def choose_admission(host: str, token: str, *, wanted: bool = True) -> Admission:
    """Choose the secrets that let a browser in.

    Args:
        host: The page is served on this address.
        token: The one that is chosen; empty: a new one is made up, with a ticket.
        wanted: Whether it must know anything.

    Raises:
        ScenarioError: If the token cannot be one, or there shall be none where other machines reach the page.
    """
    if not wanted:
        if token:
            raise ScenarioError(
                "--no-token: there is one, in --token or OUTRIDER_TOKEN; leave one of them out"
            )
        if host not in LOOPBACK:
            raise ScenarioError(
                f"--no-token: other machines reach --host {host}; allowed is this with {', '.join(LOOPBACK)}"
            )
        return Admission()
    if not token:
        return Admission(token=secrets.token_urlsafe(18), ticket=secrets.token_urlsafe(18))
    if not re.fullmatch(r"[A-Za-z0-9_-]{8,128}", token):
        raise ScenarioError("--token: allowed are 8 to 128 letters, digits, '_' and '-'")
    return Admission(token=token)


def open_socket(host: str, port: int) -> socket.socket:
    """The socket to listen on.

    Args:
        host: An address of this machine.
        port: 0 takes any that is free.

    Raises:
        ScenarioError: If the address is none of this machine's, or the port is taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        opened = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ScenarioError(f"--host {host}: {error.strerror or error}") from error
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(address)
        opened.listen(128)
    except OSError as error:
        opened.close()
        other = "; allowed: another --port" if error.errno == errno.EADDRINUSE else ""
        raise ScenarioError(
            f"cannot listen on {host}, port {port}: {error.strerror or error}{other}"
        ) from error
    return opened


def address_of(listening: socket.socket, admission: Admission) -> str:
    """The page's address for a browser of this machine, in words for its user.

    Whoever has chosen the token knows it, and may not want it in a log.
    """
    host, port = listening.getsockname()[:2]
    known = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)  # noqa: S104 - is told, not served
    address = f"http://{known}:{port}"
    if admission.ticket:
        return (
            f"{address}/?ticket={admission.ticket} (opens once; another browser asks for the token "
            f"{admission.token})"
        )
    return f"{address} to whoever has the token" if admission.token else address
