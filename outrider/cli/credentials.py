"""`outrider credentials`: who may take part in a run."""

import os
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import AccessDenied, ScenarioError
from outrider.cli.options import DEFAULT_RUN, Json, RunName

Folder = Annotated[Path, typer.Argument(help="Where to write them; is made if it is not there.")]
Whose = Annotated[
    str, typer.Option(help="Whose vehicles: a shipped scenario's name, or a TOML file.")
]
Owner = Annotated[
    str,
    typer.Option(
        metavar="UID:GID",
        help="Give the files to this user, such as a container's; for root only.",
    ),
]
Tls = Annotated[
    bool,
    typer.Option(
        "--tls/--tcp",
        help="Certificates instead of passwords, for endpoints that begin with tls/ instead of tcp/; needs "
        "the extra [tls].",
    ),
]
RouterHosts = Annotated[
    list[str] | None,
    typer.Option(
        metavar="HOST",
        help="With --tls: a name or address under which the router is found, beside localhost and `router`; "
        "may be repeated.",
    ),
]
Days = Annotated[
    float | None,
    typer.Option(
        help="How long the parties' certificates hold; 365 by default.", min=0.001, max=3650.0
    ),
]
Renew = Annotated[
    bool,
    typer.Option(
        "--renew",
        help="New certificates for the parties in FOLDER, by the authority.json that is there.",
    ),
]
Parties = Annotated[
    list[str] | None,
    typer.Option(
        help="With --renew: only this party, or `router`, which is left alone otherwise; may be repeated."
    ),
]
Check = Annotated[
    bool,
    typer.Option(
        "--check",
        help="Tell how long the certificates in FOLDER hold; exit code 1 if one does not.",
    ),
]
Roles = Annotated[
    list[str] | None,
    typer.Option(
        "--roles",
        metavar="NAME",
        help="Also for the parties of this extension, such as ros2; without it the router lets none of its "
        "messages through. May be repeated.",
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
    """Make a set of random credentials for a run.

    A file for each party, and router.json with all of them for the router.

    Each file can be read by its owner alone. Give each process its own and no other. Nothing is ever overwritten
    but by --renew.
    With --tls there is also authority.json, with which certificates are renewed: keep it, and give it to no process.

    Example: outrider credentials credentials --scenario escort --run flight
    """
    from outrider.cli.console import OUT, print_json

    added = [name for name in extensions or () if name]  # `--roles=` of a container adds none
    _refuse(
        {
            "--tls and --renew or --check": tls and (renew or check),
            "--renew and --check": renew and check,
            "--router without --tls or --renew --party router": bool(router)
            and not tls
            and "router" not in (party or ()),
            "--days without --tls or --renew": days is not None and not (tls or renew),
            "--party without --renew": bool(party) and not renew,
            "--roles and --renew or --check": bool(added) and (renew or check),
        }
    )
    if check:
        raise typer.Exit(_check(folder, json=json))
    user = _owner(owner)
    if user is not None and os.geteuid() != 0:
        raise ScenarioError(f"--owner {owner}: only root can give files away")
    if renew:
        run, files = _renew(folder, party or (), router or (), days, user)
    else:
        files = _make(folder, scenario, run, added, user, router or () if tls else None, days)
    if json:
        print_json({"run": run, "files": {name: str(path) for name, path in files.items()}})
        return
    whose = {"router": "the router: everybody", "authority": "you alone: renews certificates"}
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
    """Write new credentials of all parties: passwords, or certificates if the router's hosts are given."""
    from bus.certificates import PARTY_DAYS, new_authority
    from bus.credentials import new_certificates, new_credentials, write_credentials
    from sim.scenario.loading import load_scenario

    flown = load_scenario(scenario)
    names = ([uav.name for uav in flown.uav], [ugv.name for ugv in flown.ugv])
    if hosts is None:
        return write_credentials(
            new_credentials(run, *names, extensions=extensions), folder, None, owner
        )
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
        raise ScenarioError(f"--owner {text!r}: allowed are two numbers, such as 1000:1000")
    return int(user), int(group)


def _refuse(combinations: dict[str, bool]) -> None:
    for words, found in combinations.items():
        if found:
            raise typer.BadParameter(f"{words}: these options do not go together")


def _renew(
    folder: Path,
    names: Iterable[str],
    hosts: Iterable[str],
    days: float | None,
    owner: tuple[int, int] | None,
) -> tuple[str, dict[str, Path]]:
    """New certificates for parties that have some, in the place of the old ones; the run's name, and the files."""
    from msgspec.structs import replace

    from bus.certificates import AUTHORITY_DAYS, PARTY_DAYS, ROUTER_HOSTS, hosts_of, issue
    from bus.credentials import (
        AUTHORITY_FILE,
        ROUTER_FILE,
        read_authority,
        read_credential,
        read_credentials,
        replace_credentials,
    )

    authority = read_authority(folder / f"{AUTHORITY_FILE}.json")
    router = read_credentials(folder / f"{ROUTER_FILE}.json")
    known = [credential.name for credential in router.parties]
    wanted = list(names) or [name for name in known if (folder / f"{name}.json").exists()]
    for name in wanted:
        if name not in (*known, ROUTER_FILE):
            raise AccessDenied(
                f"--party {name}: no party of the run {router.run}; there are {', '.join((*known, ROUTER_FILE))}"
            )
    if router.tls is None:
        raise AccessDenied(f"{folder}: these credentials are passwords, which do not end")
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
    """Tell of every file in a folder whether it is good, and how long."""
    from bus.certificates import Identity, check_identity, expiry_warning
    from bus.credentials import ROUTER_FILE, read_credential, read_credentials
    from outrider.cli.console import OUT, print_json

    if not folder.is_dir():
        raise AccessDenied(f"{folder}: no such folder")
    told: list[dict[str, object]] = []
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
        told.append(row)
        try:
            identity: Identity | None = (
                read_credentials(path) if name == ROUTER_FILE else read_credential(path)
            ).tls
            if identity is None:
                row["note"] = "a password, which does not end"
                continue
            end = check_identity(identity, name)
            row |= {
                "ends": end.isoformat(),
                "days": (end - datetime.now(UTC)).days,
                "note": expiry_warning(name, end),
            }
        except AccessDenied as error:
            row |= {"good": False, "note": str(error)}
    if json:
        print_json({"credentials": told})
    else:
        for row in told:
            until = f"until {str(row['ends'])[:10]} ({row['days']} days)  " if row["ends"] else ""
            good = "good" if row["good"] else "NOT GOOD"
            OUT.tell(f"{row['file']}  {good}  {until}{row['note']}")
    return int(not all(row["good"] for row in told))
