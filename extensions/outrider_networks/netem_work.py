"""Work of `outrider network netem`."""

import re
from collections.abc import Sequence

from bus.errors import ScenarioError
from bus.profiles import PROFILES
from outrider.cli.console import OUT, print_json
from outrider.running.resolve import resolve
from outrider_networks.netem import NetemLine, netem_line, netem_lines
from sim.input.faults import one_line
from sim.scenario.link_profiles import find_profile, is_file_of_profiles

_RATE = 20.0
"""Messages per second on a profile's link, unless given [1/s]."""


def print_netem(
    source: str,
    *,
    changes: Sequence[str] | None,
    network: str,
    rate: float | None,
    device: str,
    json: bool,
) -> None:
    """Print the commands for the links of a scenario, or for a profile."""
    if not re.fullmatch(r"[A-Za-z0-9_.@:-]{1,15}", device):
        raise ScenarioError(
            f"--device {one_line(device)}: not a network device; allowed: as in `ip link`"
        )
    if source in PROFILES or is_file_of_profiles(source):
        if changes or network:
            option = "--set" if changes else "--network"
            raise ScenarioError(
                f"{option}: {one_line(source)} is a profile; allowed: with a scenario"
            )
        lines = [netem_line(source, find_profile(source, "profile"), rate or _RATE, device)]
    elif rate is not None:
        raise ScenarioError(
            f"--rate {rate:g}: the scenario defines the rates; allowed: with a profile"
        )
    else:
        lines = netem_lines(resolve(source, changes=changes, network=network)[0], device)
    if json:
        print_json(lines)
        return
    for line in lines:
        _print(line)


def _print(line: NetemLine) -> None:
    OUT.tell(one_line(f"# {line.link}: {line.rate:g} messages per second"))
    for difference in line.differences:
        OUT.tell(one_line(f"# not reproduced: {difference}"))
    if line.command is not None:
        OUT.tell(line.command)
