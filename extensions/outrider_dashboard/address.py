"""Address of the page: listening socket, access token and proxies in front of it."""

import errno
import ipaddress
import re
import secrets
import socket
from typing import NamedTuple

from bus.errors import ScenarioError
from bus.locator import LOOPBACK

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
"""Address of a proxy, or of a network of proxies."""
LOCAL_PROXIES: tuple[Network, ...] = (
    ipaddress.ip_network("127.0.0.0/8"),
    ipaddress.ip_network("::1"),
)
"""Proxies on this machine, which are always trusted."""


class Access(NamedTuple):
    """Conditions of access to the page."""

    token: str = ""
    """Access token; empty: every browser on this machine is admitted."""
    proxies: tuple[Network, ...] = LOCAL_PROXIES
    """Proxies whose statements on a request are trusted."""


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


def trusted_proxies(text: str) -> tuple[Network, ...]:
    """Return the proxies on this machine and those in a list of addresses and networks, separated by commas.

    Raises:
        ScenarioError: If one is neither an address nor a network.
    """
    found = list(LOCAL_PROXIES)
    for one in filter(None, map(str.strip, text.split(","))):
        try:
            found.append(ipaddress.ip_network(one, strict=False))
        except ValueError as error:
            raise ScenarioError(
                f"--proxy {one}: neither an IP address nor a network; allowed: such as 192.0.2.7 or 172.16.0.0/12"
            ) from error
    return tuple(found)


def address_among(host: str, networks: tuple[Network, ...]) -> bool:
    """Return whether an IP address belongs to one of the networks."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    address = getattr(address, "ipv4_mapped", None) or address
    return any(address in network for network in networks)


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
