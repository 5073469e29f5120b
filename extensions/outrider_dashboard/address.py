"""Address of the page: listening socket and access token."""

import errno
import re
import secrets
import socket

from bus.errors import ScenarioError
from bus.locator import LOOPBACK

_TOKEN = re.compile(r"[A-Za-z0-9_-]{20,128}")


def choose_token(host: str, token: str, *, wanted: bool = True) -> str:
    """Return the access token of the page; empty if the page is open to all browsers on this machine.

    Args:
        host: Address to serve the page on.
        token: Token chosen by the user; empty: generate a random one of 144 bits.
        wanted: False to serve the page without a token.

    Raises:
        ScenarioError: If the token is too weak, or other machines can reach a page without a token.
    """
    if wanted:
        if token and not _TOKEN.fullmatch(token):
            raise ScenarioError(
                "--token: invalid token; allowed: 20 to 128 letters, digits, '_' and '-'"
            )
        return token or secrets.token_urlsafe(18)
    if token:
        raise ScenarioError(
            "--no-token: a token is set in --token or OUTRIDER_TOKEN; allowed: one of the two"
        )
    if host not in LOOPBACK:
        raise ScenarioError(
            f"--no-token: other machines can reach --host {host}; allowed: {', '.join(LOOPBACK)}"
        )
    return ""


def open_socket(host: str, port: int) -> socket.socket:
    """Open a listening socket on an address of this machine.

    Args:
        host: Host name or IP address.
        port: TCP port; 0: any free port.

    Raises:
        ScenarioError: If the address does not belong to this machine, or the port is in use.
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
    """Return the URL of the page for a browser on this machine."""
    host, port = listening.getsockname()[:2]
    known = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)  # noqa: S104 - printed, not served
    return f"http://{known}:{port}/" + (f"?token={token}" if token else "")
