"""`outrider credentials`: who may take part in a run."""

from pathlib import Path
from typing import Annotated

import typer

from outrider.cli.options import DEFAULT_RUN, Json, RunName


def command(
    folder: Annotated[Path, typer.Argument(help="Where to write them; is made if it is not there.")] = Path("credentials"),
    scenario: Annotated[str, typer.Option(help="Whose vehicles: a shipped scenario's name, or a TOML file.")] = "escort",
    run: RunName = DEFAULT_RUN,
    owner: Annotated[
        str, typer.Option(metavar="UID:GID", help="Give the files to this user, such as a container's; for root only.")
    ] = "",
    json: Json = False,
) -> None:
    """Make a set of random credentials for a run: a file for each party, and router.json with all of them for the router.

    Each file can be read by its owner alone. Give each process its own and no other. Nothing is ever overwritten.

    Example: outrider credentials credentials --scenario escort --run flight
    """
    import os

    from bus.access import new_credentials, write_credentials
    from bus.errors import ScenarioError
    from outrider.cli.console import OUT, print_json
    from sim.scenario import load_scenario

    user = _owner(owner)
    flown = load_scenario(scenario)
    given = new_credentials(run, (uav.name for uav in flown.uav), (ugv.name for ugv in flown.ugv))
    files = write_credentials(given, folder)
    if user is not None:
        try:
            for path in (folder, *files.values()):
                os.chown(path, *user)
        except PermissionError as error:
            raise ScenarioError(f"--owner {owner}: only root can give files away ({folder} is written and yours)") from error
    if json:
        print_json({"run": run, "files": {name: str(path) for name, path in files.items()}})
        return
    for name, path in files.items():
        OUT.print(f"{path}  for {'the router: everybody' if name == 'router' else name}", soft_wrap=True)


def _owner(text: str) -> tuple[int, int] | None:
    from bus.errors import ScenarioError

    if not text:
        return None
    user, _, group = text.partition(":")
    if not (user.isdecimal() and group.isdecimal()):
        raise ScenarioError(f"--owner {text!r}: allowed are two numbers, such as 1000:1000")
    return int(user), int(group)
