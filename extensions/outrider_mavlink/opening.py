"""Sockets of `outrider mavlink`."""

import sys

from bus.errors import ScenarioError
from bus.locator import LOOPBACK
from outrider_mavlink.udp import Address, Network, parse_address, private_port


def private_address() -> str:
    """Return a random free address of this machine."""
    return f"127.0.0.1:{private_port()}"


def open_network(
    what: str, out: list[str], listen: list[str], *, private: bool, insecure: bool
) -> Network:
    """Open the sockets, and print the addresses.

    Raises:
        ScenarioError: If an address is invalid, or other machines can reach it.
    """
    listening = {text: parse_address(text, listens=True) for text in listen}
    _check_listening(listening, insecure=insecure)
    targets = [parse_address(text, listens=False) for text in out]
    network = Network(targets, list(listening.values()))
    _print_addresses(what, out, listen, private=private)
    return network


def _print_addresses(what: str, out: list[str], listen: list[str], *, private: bool) -> None:
    """Print the addresses first, since any process may receive UDP datagrams."""
    if out:
        chosen = "" if private else "; use --private for a random port, or --to HOST:PORT"
        sys.stderr.write(
            f"sending {what} to {', '.join(out)}: any user's process can listen there{chosen}\n"
        )
    if listen:
        sys.stderr.write(
            f"sending {what} to any process, of any user, that connects to {', '.join(listen)}\n"
        )


def _check_listening(addresses: dict[str, Address], *, insecure: bool) -> None:
    """Reject addresses open to other machines, since MAVLink has no authentication.

    Raises:
        ScenarioError: If other machines can reach an address.
    """
    for text, address in addresses.items():
        if not (insecure or address.host in LOOPBACK):
            raise ScenarioError(
                f"--in {text}: other machines can reach it without a password; allowed: a local address, or --insecure"
            )
