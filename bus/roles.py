"""Roles that extensions and other packages add to a run, by entry points `outrider.roles`.

Such a role has the key-table rows of an observer, of an operator, or none. It may also have its own keys, outside the
keys of every run: no package can grant a party a key that the table does not grant.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import zenoh

from bus import plugins
from bus.errors import AccessDenied, OutriderError, ScenarioError
from bus.keys import KEYS, MAX_SESSIONS, ROOT, STAFF, Grant, Party, Role, token

RESERVED = (*STAFF, "router", "authority")
"""Names that no vehicle and no party of an extension may have."""
_BASES = (Role.GUEST, Role.OBSERVER, Role.OPERATOR)
_BUILT_IN = frozenset(role.value for role in Role if role is not Role.GUEST)


@dataclass(frozen=True, slots=True, kw_only=True)
class Roles:
    """Roles of one package: the object of an entry point."""

    parties: Mapping[str, Role]
    """Key-table role of each party: `GUEST` (no rows), `OBSERVER` or `OPERATOR`.

    A party and its role have the same name."""
    grants: Callable[[Party], Sequence[Grant]]
    """Function that returns a party's grants outside the key table, for every party of a run with one of these
    roles.
    """


@functools.cache
def extension_roles() -> Mapping[str, Roles]:
    """Return the roles by name of their entry point; skip invalid ones, with a warning."""
    found: dict[str, Roles] = {}
    for name, roles in plugins.load_all("roles", Roles).items():
        taken = {*RESERVED, *_BUILT_IN, Role.GUEST.value}.union(
            *(r.parties for r in found.values())
        )
        try:
            with plugins.foreign():
                check_roles(roles, taken)
        except OutriderError as error:
            plugins.ignore_named("roles", name, error)
        else:
            found[name] = roles
    return found


def check_roles(roles: Roles, taken: set[str]) -> None:
    """Check the names and bases of a package's roles.

    Raises:
        ValueError: If a name is taken, or a role would get more than an operator's rows.
    """
    for name, base in roles.parties.items():
        if name in taken:
            raise ValueError(f"party {name!r}: the name is taken")
        if base not in _BASES:
            raise ValueError(f"party {name!r}: base {base!r}; allowed: {', '.join(_BASES)}")


def named_roles(name: str) -> Roles:
    """Return the roles of one entry point.

    Raises:
        ScenarioError: If there is none of this name.
    """
    known = extension_roles()
    if name not in known:
        raise ScenarioError(
            f"--roles {name}: unknown roles; available: {', '.join(known) or 'none'}"
        )
    return known[name]


def party_of(role: str, name: str) -> Party:
    """Return the party of this role and name.

    Raises:
        AccessDenied: If the role is unknown here.
    """
    if role in _BUILT_IN:
        return Party(role=Role(role), name=name)
    for roles in extension_roles().values():
        if role in roles.parties:
            return Party(role=roles.parties[role], name=name, extension=role)
    raise AccessDenied(f"{name}: role {role!r} is unknown; is its extension installed?")


def roles_among(parties: Sequence[Party]) -> list[Roles]:
    """Return the extension roles that at least one of these parties has."""
    present = {party.extension for party in parties}
    return [roles for roles in extension_roles().values() if not present.isdisjoint(roles.parties)]


def own_grants(roles: Roles, party: Party) -> tuple[Grant, ...]:
    """Return a party's grants outside the key table, after checking that none touches a key of a run.

    Raises:
        AccessDenied: If one does.
    """
    found = tuple(roles.grants(party))
    for grant in found:
        for key in grant.keys:
            _check_outside(key)
    return found


def _check_outside(key: str) -> None:
    """Reject a key under `outrider/`, or one that matches a key or liveliness token of a run."""
    try:
        expression = zenoh.KeyExpr(key)
        first = zenoh.KeyExpr(key.partition("/")[0])
        inside = (key.partition("/")[0] not in ("*", "**") and first.intersects(ROOT)) or any(
            expression.intersects(own) for own in _keys_of_runs()
        )
    except zenoh.ZError as error:
        raise AccessDenied(f"key {key!r} of an extension's role: {error}") from error
    if inside:
        raise AccessDenied(f"key {key!r} of an extension's role: overlaps a run's own keys")


@functools.cache
def _keys_of_runs() -> tuple[str, ...]:
    numbers = [*range(MAX_SESSIONS), *(role.value for role in Role)]
    return (
        *(key.expression("*", "*") for key in KEYS),
        *(token("*", "*", number) for number in numbers),
    )
