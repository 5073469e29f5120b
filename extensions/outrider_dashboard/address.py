"""Address of the page: the socket that it is served on, and the token that opens it."""

import errno
import re
import secrets
import socket

from bus.errors import ScenarioError
from bus.locator import LOOPBACK

_TOKEN = re.compile(r"[A-Za-z0-9_-]{20,128}")


def choose_token(host: str, token: str, *, wanted: bool = True) -> str:
    """Return the token that opens the page; empty if every browser of this machine may.

    Args:
        host: Address that the page is served on.
        token: The user's own token; empty: a random one of 144 bits.
        wanted: False serves the page without a token.

    Raises:
        ScenarioError: If the token can be guessed, or other machines reach a page without one.
    """
    if wanted:
        if token and not _TOKEN.fullmatch(token):
            raise ScenarioError("--token: allowed are 20 to 128 letters, digits, '_' and '-'")
        return token or secrets.token_urlsafe(18)
    if token:
        raise ScenarioError(
            "--no-token: there is a token in --token or OUTRIDER_TOKEN; leave one of them out"
        )
    if host not in LOOPBACK:
        raise ScenarioError(
            f"--no-token: other machines reach --host {host}; allowed: {', '.join(LOOPBACK)}"
        )
    return ""


def open_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens on an address of this machine.

    Args:
        host: Name or address.
        port: 0 takes any free port.

    Raises:
        ScenarioError: If the address is not one of this machine, or the port is taken.
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


def address_of(listening: socket.socket, token: str) -> str:
    """Return the address that opens the page in a browser of this machine."""
    host, port = listening.getsockname()[:2]
    known = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)  # noqa: S104 - printed, not served
    return f"http://{known}:{port}/" + (f"?token={token}" if token else "")
