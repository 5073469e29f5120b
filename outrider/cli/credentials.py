"""`outrider credentials`: credentials of the parties of a run."""

import os
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from bus.credentials import (
    AUTHORITY_FILE,
    ROUTER_FILE,
    new_certificates,
    new_credentials,
    read_authority,
    read_credential,
    read_credentials,
    replace_credentials,
    write_credentials,
)
from bus.errors import AccessDenied, ScenarioError
from bus.identities import AUTHORITY_DAYS, PARTY_DAYS, ROUTER_HOSTS, Identity, expiry_warning
from outrider.cli.console import OUT, print_json
from outrider.cli.options import DEFAULT_RUN, Json, RunName

Folder = Annotated[Path, typer.Argument(help="Folder for the files; created if missing.")]
Whose = Annotated[
    str, typer.Option(help="Scenario with the vehicles: a shipped scenario's name, or a TOML file.")
]
Owner = Annotated[
    str,
    typer.Option(
        metavar="UID:GID",
        help="Give the files to this user; needs root.",
    ),
]
Tls = Annotated[
    bool,
    typer.Option(
        "--tls/--tcp",
        help="Make certificates for tls/ endpoints, not passwords; needs the extra [tls].",
    ),
]
RouterHosts = Annotated[
    list[str] | None,
    typer.Option(
        metavar="HOST",
        help="With --tls: add a host name or address of the router; repeatable.",
    ),
]
Days = Annotated[
    float | None,
    typer.Option(
        help="Set the parties' certificates to expire after this many days; default 365.",
        min=0.001,
        max=3650.0,
    ),
]
Renew = Annotated[
    bool,
    typer.Option(
        "--renew",
        help="Renew the certificates in FOLDER with its authority.json.",
    ),
]
Parties = Annotated[
    list[str] | None,
    typer.Option(help="With --renew: renew only this party (`router` only if named); repeatable."),
]
Check = Annotated[
    bool,
    typer.Option(
        "--check",
        help="Print when the certificates in FOLDER expire; exit with 1 if invalid.",
    ),
]
Roles = Annotated[
    list[str] | None,
    typer.Option(
        "--roles",
        metavar="NAME",
        help="Add the parties of this extension, such as ros2; repeatable.",
    ),
]


def command(
    folder: Folder = Path("credentials"),
    scenario: Whose = "escort",
    run: RunName = DEFAULT_RUN,
    owner: Owner = "",
    tls: Tls = False,
    router: RouterHosts = None,
    days: Days = None,
    renew: Renew = False,
    party: Parties = None,
    check: Check = False,
    extensions: Roles = None,
    json: Json = False,
) -> None:
    """Make random credentials for a run.

    Writes one file for each party, and router.json with all credentials for the router.

    Only the owner can read the files. Give each process its own file and no other. Only --renew overwrites files.
    With --tls, the command also writes authority.json, which renews certificates. Keep this file, and give it to no
    process. Without --roles, the router rejects all messages of an extension's parties.

    Example: outrider credentials credentials --scenario escort --run flight
    """
    added = [name for name in extensions or () if name]  # `--roles=` of a container adds none
    _check_options(
        {
            "--tls with --renew or --check": tls and (renew or check),
            "--renew with --check": renew and check,
            "--router without --tls or --renew --party router": bool(router)
            and not tls
            and "router" not in (party or ()),
            "--days without --tls or --renew": days is not None and not (tls or renew),
            "--party without --renew": bool(party) and not renew,
            "--roles with --renew or --check": bool(added) and (renew or check),
        }
    )
    if check:
        raise typer.Exit(_check(folder, json=json))
    user = _owner(owner)
    if user is not None and os.geteuid() != 0:
        raise ScenarioError(f"--owner {owner}: only root can change the owner; leave --owner out")
    if renew:
        run, files = _renew(folder, party or (), router or (), days, user)
    else:
        files = _make(folder, scenario, run, added, user, router or () if tls else None, days)
    if json:
        print_json({"run": run, "files": {name: str(path) for name, path in files.items()}})
        return
    whose = {"router": "the router (all parties)", "authority": "you only (renews certificates)"}
    for name, path in files.items():
        OUT.tell(f"{path}  {'renewed ' if renew else ''}for {whose.get(name, name)}")


def _make(
    folder: Path,
    scenario: str,
    run: str,
    extensions: Sequence[str],
    owner: tuple[int, int] | None,
    hosts: Sequence[str] | None,
    days: float | None,
) -> dict[str, Path]:
    """Write new credentials of all parties: certificates if the router's hosts are given, otherwise passwords."""
    from sim.scenario.loading import load_scenario  # noqa: PLC0415 - the compiler

    flown = load_scenario(scenario)
    names = ([uav.name for uav in flown.uav], [ugv.name for ugv in flown.ugv])
    if hosts is None:
        return write_credentials(
            new_credentials(run, *names, extensions=extensions), folder, None, owner
        )
    from bus.certificates import new_authority  # noqa: PLC0415 - the extra [tls]

    authority = new_authority(run)
    given = new_certificates(
        authority, *names, hosts=hosts, days=days or PARTY_DAYS, extensions=extensions
    )
    return write_credentials(given, folder, authority, owner)


def _owner(text: str) -> tuple[int, int] | None:
    if not text:
        return None
    user, _, group = text.partition(":")
    if not (user.isdecimal() and group.isdecimal()):
        raise ScenarioError(
            f"--owner {text!r}: wrong form; allowed: two numbers, such as 1000:1000"
        )
    return int(user), int(group)


def _check_options(combinations: dict[str, bool]) -> None:
    for options, found in combinations.items():
        if found:
            raise typer.BadParameter(f"{options}: these options cannot be combined")


def _renew(
    folder: Path,
    names: Iterable[str],
    hosts: Iterable[str],
    days: float | None,
    owner: tuple[int, int] | None,
) -> tuple[str, dict[str, Path]]:
    """Replace the certificates of some parties by new ones; return the run's name and the files."""
    from bus.certificates import hosts_of, issue  # noqa: PLC0415 - the extra [tls]

    authority = read_authority(folder / f"{AUTHORITY_FILE}.json")
    router = read_credentials(folder / f"{ROUTER_FILE}.json")
    known = [credential.name for credential in router.parties]
    wanted = list(names) or [name for name in known if (folder / f"{name}.json").exists()]
    for name in wanted:
        if name not in (*known, ROUTER_FILE):
            raise AccessDenied(
                f"--party {name}: no party of the run {router.run}; allowed: {', '.join((*known, ROUTER_FILE))}"
            )
    if router.tls is None:
        raise AccessDenied(f"{folder}: these credentials are passwords, which do not expire")
    renewed = {}
    for name in wanted:
        path = renewed[name] = folder / f"{name}.json"
        if name == ROUTER_FILE:
            known_at = tuple(dict.fromkeys((*hosts_of(router.tls), *hosts))) or ROUTER_HOSTS
            identity = issue(authority, name, days=days or AUTHORITY_DAYS, hosts=known_at)
            replace_credentials(replace(router, tls=identity), path, owner)
        else:
            identity = issue(authority, name, days=days or PARTY_DAYS)
            replace_credentials(replace(read_credential(path), tls=identity), path, owner)
    return router.run, renewed


def _check(folder: Path, *, json: bool) -> int:
    """Print for each file in a folder if it is valid, and until when; return the exit code."""
    if not folder.is_dir():
        raise AccessDenied(f"{folder}: folder not found")
    files: list[dict[str, object]] = []
    for path in sorted(folder.glob("*.json")):
        name = path.stem
        if name == "authority":
            continue
        row: dict[str, object] = {
            "file": str(path),
            "good": True,
            "ends": None,
            "days": None,
            "note": "",
        }
        files.append(row)
        try:
            identity: Identity | None = (
                read_credentials(path) if name == ROUTER_FILE else read_credential(path)
            ).tls
            if identity is None:
                row["note"] = "a password, which does not expire"
                continue
            from bus.certificates import check_identity  # noqa: PLC0415 - the extra [tls]

            end = check_identity(identity, name)
            row |= {
                "ends": end.isoformat(),
                "days": (end - datetime.now(UTC)).days,
                "note": expiry_warning(name, end),
            }
        except AccessDenied as error:
            row |= {"good": False, "note": str(error)}
    if json:
        print_json({"credentials": files})
    else:
        for row in files:
            until = f"until {str(row['ends'])[:10]} ({row['days']} days)  " if row["ends"] else ""
            good = "valid" if row["good"] else "INVALID"
            OUT.tell(f"{row['file']}  {good}  {until}{row['note']}")
    return int(not all(row["good"] for row in files))
