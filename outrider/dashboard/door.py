"""Before the page is served: the socket it is served on, who may come in, and whether the extra is installed."""

import re
import secrets
import socket
from importlib.util import find_spec

from bus.errors import ScenarioError
from outrider.dashboard import LOOPBACK

NEW_TOKEN = "new"  # noqa: S105 - stands for one that is made up
"""Instead of a token: make one up and print it."""
_NEEDED = ("nicegui",)


def check_extra() -> None:
    """Refuse to begin without what serves the page.

    Raises:
        ScenarioError: If it is not installed.
    """
    for module in _NEEDED:
        if find_spec(module) is None:
            raise ScenarioError(f"{module} is missing: pip install 'outrider[dashboard]'")


def check_token(host: str, token: str) -> str:
    """The token that a browser must know; empty: none.

    Raises:
        ScenarioError: If it cannot be one, or there is none where other machines reach the page.
    """
    if token == NEW_TOKEN:
        return secrets.token_urlsafe(18)
    if token and not re.fullmatch(r"[A-Za-z0-9_-]{8,128}", token):
        raise ScenarioError("--token: allowed are 8 to 128 letters, digits, '_' and '-', or the word new")
    if not token and host not in LOOPBACK:
        raise ScenarioError(f"--host {host}: other machines reach it, and there is no token; give one with --token")
    return token


def open_socket(host: str, port: int, option: str = "--port") -> socket.socket:
    """The socket to listen on.

    Args:
        host: An address of this machine.
        port: 0 takes any that is free.
        option: What another port is asked for with.

    Raises:
        ScenarioError: If the address is none of this machine's, or the port is taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        opened = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ScenarioError(f"--host {host}: {error.strerror or error}") from error
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(address)
        opened.listen(128)
    except OSError as error:
        opened.close()
        raise ScenarioError(f"cannot listen on {host}, port {port}: {error.strerror or error}; try another {option}") from error
    return opened


def address_of(listening: socket.socket) -> str:
    """Where a browser of this machine finds the page."""
    host, port = listening.getsockname()[:2]
    known = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)  # noqa: S104 - is told, not served
    return f"http://{known}:{port}"
