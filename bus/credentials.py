"""Credentials that identify parties to the router, and their files.

Credentials are passwords, or certificates (`bus.certificates`) if traffic is encrypted.
"""

import os
import secrets
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta

from bus.errors import AccessDenied
from bus.files import read_regular, write_whole
from bus.identities import AUTHORITY_DAYS, PARTY_DAYS, ROUTER_HOSTS, Authority, Identity
from bus.keys import STAFF, Party, Role
from bus.messages.base import Name
from bus.roles import RESERVED, named_roles, party_of

_PASSWORD_BYTES = 24
_MOST_BYTES = 4 << 20
"""Maximum size of a credentials file [bytes]: enough for ten thousand parties."""
_Kind = TypeVar("_Kind")
ROUTER_FILE = "router"
"""Name of the router's file, which holds the credentials of all parties, and common name of its certificate."""
AUTHORITY_FILE = "authority"
"""Name of the file that renews certificates; it belongs to the owner, not to a process."""


class Credential(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Credential of one party: a password or a certificate."""

    name: Name
    role: Name
    """Role of the key table or of an extension."""
    password: Annotated[str, Meta(pattern="^[A-Za-z0-9_-]{8,128}$")] | None = None
    tls: Identity | None = None

    @property
    def party(self) -> Party:
        """Return the party of the credential.

        Raises:
            AccessDenied: If the role is unknown here.
        """
        return party_of(self.role, self.name)

    def __repr__(self) -> str:
        """Omit the password: it must not appear in a log."""
        return f"Credential(name={self.name!r}, role={self.role!r})"


class CredentialSet(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Credentials of all parties of one run, for its router only."""

    run: str
    parties: tuple[Credential, ...]
    tls: Identity | None = None
    """Identity of the router itself, if parties use certificates; of the parties it then needs only the names."""

    def for_router(self) -> "CredentialSet":
        """Return a copy without the parties' keys, which the router does not need."""
        return msgspec.structs.replace(
            self, parties=tuple(msgspec.structs.replace(party, tls=None) for party in self.parties)
        )

    def of(self, name: str) -> Credential:
        """Return the credential of one party.

        Raises:
            AccessDenied: If there is none of this name.
        """
        for credential in self.parties:
            if credential.name == name:
                return credential
        raise AccessDenied(
            f"no credentials for {name}; available: {', '.join(c.name for c in self.parties)}"
        )


def new_credentials(
    run: str, uavs: Iterable[str], ugvs: Iterable[str], *, extensions: Iterable[str] = ()
) -> CredentialSet:
    """Return random passwords for a run's vehicles, simulator, operator and observers.

    Args:
        run: Name of the run.
        uavs: Names of the UAVs.
        ugvs: Names of the UGVs.
        extensions: Names of entry points `outrider.roles` whose parties take part.

    Raises:
        ValueError: If two parties have the same name.
    """
    made = tuple(
        msgspec.convert(
            {"name": name, "role": role, "password": secrets.token_urlsafe(_PASSWORD_BYTES)},
            Credential,
        )
        for name, role in _roles(uavs, ugvs, extensions)
    )
    return CredentialSet(run=run, parties=made)


def new_certificates(
    authority: Authority,
    uavs: Iterable[str],
    ugvs: Iterable[str],
    *,
    hosts: Sequence[str] = (),
    days: float = PARTY_DAYS,
    extensions: Iterable[str] = (),
) -> CredentialSet:
    """Return certificates for a run's router, vehicles, simulator, operator and observers.

    Args:
        authority: Authority that signs them.
        uavs: Names of the UAVs.
        ugvs: Names of the UGVs.
        hosts: Names and addresses of the router, in addition to `ROUTER_HOSTS`.
        days: Lifetime of the parties' certificates [days]; the router's lasts as long as the authority.
        extensions: Names of entry points `outrider.roles` whose parties take part.

    Raises:
        ValueError: If two parties have the same name.
        AccessDenied: If the authority has expired, or a host is invalid.
        BusError: If the extra [tls] is missing.
    """
    from bus.certificates import issue  # noqa: PLC0415 - the extra [tls]

    made = tuple(
        msgspec.convert(
            {"name": name, "role": role, "tls": issue(authority, name, days=days)}, Credential
        )
        for name, role in _roles(uavs, ugvs, extensions)
    )
    known_at = tuple(dict.fromkeys((*ROUTER_HOSTS, *hosts)))
    router = issue(authority, ROUTER_FILE, days=AUTHORITY_DAYS, hosts=known_at)
    return CredentialSet(run=authority.run, parties=made, tls=router)


def _roles(
    uavs: Iterable[str], ugvs: Iterable[str], extensions: Iterable[str]
) -> list[tuple[str, str]]:
    roles: list[tuple[str, str]] = [(name, Role.UAV.value) for name in uavs]
    roles += [(name, Role.UGV.value) for name in ugvs]
    roles += [(name, role.value) for name, role in STAFF.items()]
    roles += [(name, name) for given in extensions for name in named_roles(given).parties]
    names = [name for name, _ in roles]
    for name in names:
        if names.count(name) > 1 or name in (ROUTER_FILE, AUTHORITY_FILE):
            others = [role for role, kind in roles if role == kind and role not in STAFF]
            taken = ", ".join((*RESERVED, *others))
            raise ValueError(f"{name}: two parties have this name; reserved: {taken}")
    return roles


def write_credentials(
    given: CredentialSet,
    folder: Path,
    authority: Authority | None = None,
    owner: tuple[int, int] | None = None,
) -> dict[str, Path]:
    """Write one file for each party, and one with all of them for the router; mode 600.

    Args:
        given: Credentials to write.
        folder: Destination; created with mode 700 if missing.
        authority: Authority that signed the certificates.
        owner: User and group that become owner of the files, and finally of the folder.

    Returns:
        File of each name; the router's is `ROUTER_FILE`, the authority's `AUTHORITY_FILE`.

    Raises:
        OSError: If a file cannot be written, or exists.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    contents: dict[str, Credential | CredentialSet | Authority] = {ROUTER_FILE: given.for_router()}
    contents |= {credential.name: credential for credential in given.parties}
    if authority is not None:
        contents[AUTHORITY_FILE] = authority
    files = {name: folder / f"{name}.json" for name in contents}
    for path in files.values():
        if path.exists():
            raise FileExistsError(17, "exists; credentials are never overwritten", str(path))
    for name, content in contents.items():
        write_credential(content, files[name], owner)
    if owner is not None:
        give_folder(folder, owner)
    return files


def write_credential(
    content: Credential | CredentialSet | Authority,
    path: Path,
    owner: tuple[int, int] | None = None,
) -> None:
    """Write credentials into a new file; mode 600.

    Raises:
        OSError: If it cannot be written, or exists.
    """
    write_whole(path, _encoded(content), private=True, fresh=True, owner=owner)


def _encoded(content: Credential | CredentialSet | Authority) -> bytes:
    return msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"


def replace_credentials(
    content: Credential | CredentialSet, path: Path, owner: tuple[int, int] | None = None
) -> None:
    """Replace credentials by renewed ones; the owner stays the same by default.

    The replacement is atomic, and the file is never readable by others.

    Raises:
        OSError: If it cannot be written.
    """
    if owner is None:
        old = path.lstat()
        mine = (old.st_uid, old.st_gid) == (os.geteuid(), os.getegid())
        owner = None if mine else (old.st_uid, old.st_gid)
    write_whole(path, _encoded(content), private=True, owner=owner)


def give_folder(folder: Path, owner: tuple[int, int]) -> None:
    """Change the owner of a folder through an open descriptor, which does not follow a symbolic link.

    Raises:
        OSError: If the owner cannot be changed.
    """
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        os.fchmod(opened, 0o700)
        os.fchown(opened, *owner)
    finally:
        os.close(opened)


def _read(path: Path, kind: type[_Kind], what: str) -> _Kind:
    try:
        status = path.stat()
        mode = stat.S_IMODE(status.st_mode)
        # A container's secrets belong to another user, who protects them.
        if mode & 0o077 and status.st_uid == os.geteuid():
            raise AccessDenied(
                f"{path}: others can read these credentials (mode {mode:o}); run chmod 600"
            )
        return msgspec.json.decode(read_regular(path, _MOST_BYTES), type=kind)
    except OSError as error:
        raise AccessDenied(f"{path}: cannot read {what}: {error.strerror or error}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise AccessDenied(f"{path}: not {what}: {error}") from error


def read_credential(path: Path) -> Credential:
    """Return one party's credential.

    Raises:
        AccessDenied: If it cannot be read, is invalid, or is readable by others.
    """
    found = _read(path, Credential, "a party's credentials")
    if (found.password is None) == (found.tls is None):
        raise AccessDenied(
            f"{path}: not a party's credentials: needs either a password or a certificate"
        )
    _check_role(path, found)
    return found


def read_credentials(path: Path) -> CredentialSet:
    """Return the router's credentials.

    Raises:
        AccessDenied: If they cannot be read, are invalid, or are readable by others.
    """
    found = _read(path, CredentialSet, "a router's credentials")
    for party in found.parties:
        _check_role(path, party)
        if (party.password is None) == (found.tls is None):
            raise AccessDenied(
                f"{path}: not a router's credentials: {party.name} needs a password, or the router a certificate"
            )
    return found


def _check_role(path: Path, credential: Credential) -> None:
    try:
        party_of(credential.role, credential.name)
    except AccessDenied as error:
        raise AccessDenied(f"{path}: {error}") from error


def read_authority(path: Path) -> Authority:
    """Return the authority of a run's certificates.

    Raises:
        AccessDenied: If it cannot be read, is invalid, or is readable by others.
    """
    return _read(path, Authority, "an authority")
