"""The key table turned into Zenoh's access control, and the credentials by which the router knows who is who.

There is no second list: what `bus.keys` gives a party is what the router lets through, everything else it drops. Zenoh denies
in silence, so the session asks the same table first and says `AccessDenied`.
"""

import contextlib
import os
import secrets
import stat
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from bus.errors import AccessDenied, BusError
from bus.files import read_regular
from bus.keys import (
    OBSERVER_NAME,
    OPERATOR_NAME,
    SIMULATOR_NAME,
    STAFF,
    Key,
    Party,
    Role,
    any_vehicle,
    read_by,
    token,
    written_by,
)
from bus.messages import Name

_PASSWORD_BYTES = 24
_MOST_BYTES = 4 << 20
"""Of a file of credentials: those of some ten thousand parties."""
_Kind = TypeVar("_Kind")
ROUTER_FILE = "router"
"""Name of the file that holds everybody's credentials: the router's alone."""


class Credential(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """By what the router knows one party."""

    name: Name
    role: Role
    password: Annotated[str, Meta(pattern="^[A-Za-z0-9_-]{8,128}$")]

    @property
    def party(self) -> Party:
        """Who it is for."""
        return Party(role=self.role, name=self.name)

    def __repr__(self) -> str:
        """Without the password: it must not get into a log."""
        return f"Credential(name={self.name!r}, role={self.role.value!r})"


class CredentialSet(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everybody's credentials for one run: what its router knows, and nobody else."""

    run: str
    parties: tuple[Credential, ...]

    def of(self, name: str) -> Credential:
        """One party's.

        Raises:
            AccessDenied: If there is none of this name.
        """
        for credential in self.parties:
            if credential.name == name:
                return credential
        raise AccessDenied(f"there are no credentials for {name}; there are some for {', '.join(c.name for c in self.parties)}")


def new_credentials(run: str, uavs: Iterable[str], ugvs: Iterable[str]) -> CredentialSet:
    """Random credentials for a run's vehicles, its simulator, operator and observers.

    Args:
        run: Its name.
        uavs: Names of the UAVs.
        ugvs: Names of the UGVs.

    Raises:
        ValueError: If two parties have one name.
    """
    roles = [(name, Role.UAV) for name in uavs] + [(name, Role.UGV) for name in ugvs]
    roles += [(name, STAFF[name]) for name in (SIMULATOR_NAME, OPERATOR_NAME, OBSERVER_NAME)]
    names = [name for name, _ in roles]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name}: two parties with one name; {', '.join(STAFF)} are taken")
    made = tuple(
        msgspec.convert({"name": name, "role": role.value, "password": secrets.token_urlsafe(_PASSWORD_BYTES)}, Credential)
        for name, role in roles
    )
    return CredentialSet(run=run, parties=made)


def write_private(path: Path, content: bytes) -> None:
    """Write a file that only this user can read, from its first byte on.

    Raises:
        OSError: If it cannot be written, or is there already.
    """
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def write_credentials(given: CredentialSet, folder: Path) -> dict[str, Path]:
    """Write a file for each party, and one with all of them for the router; mode 600.

    Args:
        given: What is written.
        folder: Is made if it is not there, mode 700.

    Returns:
        The file of each name; the router's is `ROUTER_FILE`.

    Raises:
        OSError: If a file cannot be written, or is there already.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    files = {name: folder / f"{name}.json" for name in (ROUTER_FILE, *(credential.name for credential in given.parties))}
    for path in files.values():
        if path.exists():
            raise FileExistsError(17, "there already; credentials are never overwritten", str(path))
    write_private(files[ROUTER_FILE], msgspec.json.format(msgspec.json.encode(given), indent=1) + b"\n")
    for credential in given.parties:
        write_private(files[credential.name], msgspec.json.encode(credential) + b"\n")
    return files


def _read(path: Path, kind: type[_Kind], what: str) -> _Kind:
    try:
        status = path.stat()
        mode = stat.S_IMODE(status.st_mode)
        if mode & 0o077 and status.st_uid == os.geteuid():  # a container's secrets are another user's, and theirs to protect
            raise AccessDenied(f"{path}: others can read these credentials (mode {mode:o}); chmod 600 it")
        return msgspec.json.decode(read_regular(path, _MOST_BYTES), type=kind)
    except OSError as error:
        raise AccessDenied(f"{path}: cannot read {what}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise AccessDenied(f"{path}: not {what}: {error}") from error


def read_credential(path: Path) -> Credential:
    """One party's credential.

    Raises:
        AccessDenied: If it cannot be read, is none, or others can read it too.
    """
    return _read(path, Credential, "a party's credentials")


def read_credentials(path: Path) -> CredentialSet:
    """The router's credentials.

    Raises:
        AccessDenied: If they cannot be read, are none, or others can read them too.
    """
    return _read(path, CredentialSet, "a router's credentials")


class Grant(msgspec.Struct, frozen=True, kw_only=True, order=True):
    """One thing the router lets through for one party: Zenoh's message kind, direction (as the router sees it) and keys."""

    message: str
    flow: str
    keys: tuple[str, ...]


def _expressions(key: Key, party: Party, run: str) -> str:
    """The keys of one row that are this party's: a vehicle's own, all of them for anybody else."""
    if key.vehicle is None:
        return key.expression(run)
    return key.expression(run, party.name if party.role is key.vehicle else "*")


def grants(party: Party, run: str) -> tuple[Grant, ...]:
    """All that the router lets through for a party: the key table, and who is there."""
    found: set[Grant] = set()
    for key in written_by(party):
        own = _expressions(key, party, run)
        found.add(Grant(message="put", flow="ingress", keys=(own,)))
        # A publisher sends only if it is told that somebody has subscribed; the simulator subscribes to all vehicles at once.
        told = (own, any_vehicle(run, key.topic)) if key.vehicle is not None else (own,)
        found.add(Grant(message="declare_subscriber", flow="egress", keys=told))
    for key in read_by(party):
        own = _expressions(key, party, run)
        wide = any_vehicle(run, key.topic) if key.vehicle is not None and party.role is Role.SIMULATOR else own
        found.add(Grant(message="declare_subscriber", flow="ingress", keys=(wide,)))
        found.add(Grant(message="put", flow="egress", keys=(own,)))
    watched = token(run, "*" if party.role is Role.SIMULATOR else SIMULATOR_NAME, "*")
    found.add(Grant(message="liveliness_token", flow="ingress", keys=(token(run, party.name, "*"),)))
    found.add(Grant(message="declare_liveliness_subscriber", flow="ingress", keys=(watched,)))
    found.add(Grant(message="liveliness_token", flow="egress", keys=(watched,)))
    return tuple(sorted(found))


def access_control(given: CredentialSet) -> dict[str, Any]:
    """Zenoh's `access_control` for a run: nothing is allowed but each party's grants."""
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for credential in given.parties:
        own = [
            {
                "id": f"{credential.name}-{number}",
                "messages": [grant.message],
                "flows": [grant.flow],
                "permission": "allow",
                "key_exprs": list(grant.keys),
            }
            for number, grant in enumerate(grants(credential.party, given.run))
        ]
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [credential.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": credential.name, "usernames": [credential.name]} for credential in given.parties],
        "policies": policies,
    }


@contextlib.contextmanager
def router_settings(given: CredentialSet | None) -> Iterator[dict[str, Any]]:
    """The settings by which a router knows its parties, for as long as it takes to open it.

    Zenoh reads names and passwords from a file; it lies in a private folder and is gone afterwards.

    Raises:
        BusError: If that file cannot be written.
    """
    if given is None:
        yield {}
        return
    lines = "".join(f"{credential.name}:{credential.password}\n" for credential in given.parties)
    try:
        folder = tempfile.TemporaryDirectory(prefix="outrider-")
    except OSError as error:
        raise BusError(f"cannot write the router's names and passwords: {error.strerror or error}") from error
    with folder as private:
        path = Path(private) / "users"
        write_private(path, lines.encode())
        yield {"transport/auth/usrpwd/dictionary_file": str(path), "access_control": access_control(given)}


def client_settings(credential: Credential | None) -> dict[str, Any]:
    """The settings by which a client says who it is."""
    if credential is None:
        return {}
    return {"transport/auth/usrpwd/user": credential.name, "transport/auth/usrpwd/password": credential.password}
