"""Parties, credentials and sessions from the options of commands that join a run."""

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from bus.credentials import Credential, read_credential
from bus.errors import AccessDenied, ScenarioError
from bus.joining import open_session
from bus.keys import OPERATOR_NAME, Party, Role
from bus.locator import check_endpoint
from bus.roles import party_of
from bus.session import Session

if TYPE_CHECKING:
    from agents.process import MakePilot


def staff_of(file: Path | None, role: Role) -> tuple[Party, Credential | None]:
    """Return the operator or observer whose credentials a file holds, with the credentials.

    Args:
        file: File of credentials; None: use the password of this process, if any.
        role: Role of the password's party. Without a password, all parties have all rights, and the operator is
            returned.

    Raises:
        AccessDenied: If the file belongs to a party of another role.
    """
    found = credential_of(None, role, role.value) if file is None else read_credential(file)
    if found is None:
        return Party(role=Role.OPERATOR, name=OPERATOR_NAME), None
    if found.role not in (Role.OPERATOR, Role.OBSERVER):
        raise AccessDenied(
            f"{file}: credentials of {found.name} ({found.role}); allowed: an operator or observer"
        )
    return found.party, found


class Joining(NamedTuple):
    """Arguments with which a process joins a run."""

    party: Party
    connect: str
    run: str
    credential: Credential | None
    join_timeout: float
    """Longest wait for a router or simulator [s]."""

    def session(self) -> AbstractContextManager[Session]:
        """Open the session; errors as in `open_session`."""
        return open_session(
            self.party,
            self.run,
            connect=self.connect,
            credential=self.credential,
            join_timeout=self.join_timeout,
        )

    def fly(self, make_pilot: "MakePilot") -> int:
        """Fly the vehicle until the run is over; result and errors as in `agents.process.fly`."""
        from agents.process import fly  # noqa: PLC0415 - the compiler, which an observer does not need

        return fly(
            self.party,
            make_pilot,
            connect=self.connect,
            run=self.run,
            credential=self.credential,
            join_timeout=self.join_timeout,
        )


def joining(
    role: str, name: str, connect: str, run: str, file: Path | None, join_timeout: float
) -> Joining:
    """Return the arguments with which a party joins; errors as in `check_endpoint`, `party_of`, `credential_of`."""
    check_endpoint(connect)
    credential = credential_of(file, role, name)
    return Joining(party_of(role, name), connect, run, credential, join_timeout)


def join(
    role: str, run: str, connect: str, file: Path | None, join_timeout: float = 10.0
) -> AbstractContextManager[Session]:
    """Open the session of a run's operator, observer or bridge; errors as in `joining`."""
    return joining(role, str(role), connect, run, file, join_timeout).session()


def credential_of(file: Path | None, role: str, name: str) -> Credential | None:
    """Return this process's credential, from its file or from OUTRIDER_PASSWORD; None without either.

    Raises:
        AccessDenied: If the file belongs to another party.
        ScenarioError: If the password is invalid.
    """
    if file is not None:
        found = read_credential(file)
        if (found.role, found.name) != (role, name):
            raise AccessDenied(
                f"{file}: credentials of {found.name} ({found.role}); allowed: {name} ({role})"
            )
        return found
    password = os.environ.get("OUTRIDER_PASSWORD")
    if not password:
        return None
    try:
        return msgspec.convert({"name": name, "role": str(role), "password": password}, Credential)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"OUTRIDER_PASSWORD or name: {error}") from error
