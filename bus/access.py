"""The key table turned into Zenoh's access control.

There is no second list: what `bus.keys` gives a party is what the router lets through, everything else it drops.
Zenoh denies in silence, so the session asks the same table first and says `AccessDenied`.
"""

import base64
import contextlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from bus.certificates import Identity
from bus.credentials import Credential, CredentialSet
from bus.errors import BusError
from bus.files import write_whole
from bus.keys import (
    PLACES,
    SIMULATOR_NAME,
    Grant,
    Key,
    Party,
    Role,
    read_by,
    slot_token,
    token,
    written_by,
)
from bus.roles import Roles, own_grants, roles_among


def _expressions(key: Key, party: Party, run: str) -> str:
    """The keys of one row that are this party's: a vehicle's own, all of them for anybody else."""
    return key.expression(run, party.name if party.role is key.vehicle else "*")


def grants(party: Party, run: str, extensions: Iterable[Roles] = ()) -> tuple[Grant, ...]:
    """All that the router lets through for a party: the key table, and who is there.

    Args:
        party: Who.
        run: Name of the run.
        extensions: Roles of extensions that take part in it.

    Raises:
        AccessDenied: If an extension grants a key of a run.
    """
    found = {grant for roles in extensions for grant in own_grants(roles, party)}
    for key in written_by(party):
        own = _expressions(key, party, run)
        found.add(Grant(message="put", flow="ingress", keys=(own,)))
        # A publisher sends only if it is told that somebody has subscribed; the simulator subscribes to all
        # vehicles at once.
        told = tuple(dict.fromkeys((own, key.expression(run, "*"))))
        found.add(Grant(message="declare_subscriber", flow="egress", keys=told))
    for key in read_by(party):
        own = _expressions(key, party, run)
        found.add(Grant(message="declare_subscriber", flow="ingress", keys=(own,)))
        found.add(Grant(message="put", flow="egress", keys=(own,)))
    watched = token(run, "*" if party.role is Role.SIMULATOR else SIMULATOR_NAME, "*")
    own = token(run, party.name, "*")
    declared = tuple(token(run, party.name, place) for place in range(PLACES))
    if party.role is Role.SIMULATOR:
        declared += tuple(slot_token(run, "*", role) for role in (Role.UAV, Role.UGV))
    found.add(Grant(message="liveliness_token", flow="ingress", keys=declared))
    found.add(Grant(message="liveliness_query", flow="ingress", keys=(own,)))
    found.add(Grant(message="declare_liveliness_subscriber", flow="ingress", keys=(watched,)))
    found.add(Grant(message="liveliness_token", flow="egress", keys=(watched, own)))
    return tuple(sorted(found))


def access_control(given: CredentialSet) -> dict[str, Any]:
    """Zenoh's `access_control` for a run: nothing is allowed but each party's grants."""
    by = "usernames" if given.tls is None else "cert_common_names"
    # The router knows the keys of an extension only where one of its parties has credentials.
    extensions = roles_among([credential.party for credential in given.parties])
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for credential in given.parties:
        own = [
            {
                "id": f"{credential.name}-{number}",
                "messages": [grant.message],
                "flows": [grant.flow],
                "permission": grant.permission,
                "key_exprs": list(grant.keys),
            }
            for number, grant in enumerate(grants(credential.party, given.run, extensions))
        ]
        rules += own
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [credential.name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [
            {"id": credential.name, by: [credential.name]} for credential in given.parties
        ],
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
    if given.tls is not None:
        yield _tls_settings(given.tls, "listen") | {"access_control": access_control(given)}
        return
    lines = "".join(f"{credential.name}:{credential.password}\n" for credential in given.parties)
    try:
        folder = tempfile.TemporaryDirectory(prefix="outrider-")
    except OSError as error:
        raise BusError(
            f"cannot write the router's names and passwords: {error.strerror or error}"
        ) from error
    with folder as private:
        path = Path(private) / "users"
        write_whole(path, lines.encode(), private=True, fresh=True)
        yield {
            "transport/auth/usrpwd/dictionary_file": str(path),
            "access_control": access_control(given),
        }


def _tls_settings(identity: Identity, side: str) -> dict[str, Any]:
    """Mutual TLS, and no other protocol beside it; Zenoh takes PEM in base64, so that no key lies in a file for it."""

    def encoded(text: str) -> str:
        return base64.b64encode(text.encode()).decode()

    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/root_ca_certificate_base64": encoded(identity.authority),
        f"transport/link/tls/{side}_certificate_base64": encoded(identity.certificate),
        f"transport/link/tls/{side}_private_key_base64": encoded(identity.key),
    }


def client_settings(credential: Credential | None) -> dict[str, Any]:
    """The settings by which a client says who it is."""
    if credential is None:
        return {}
    if credential.tls is not None:
        return _tls_settings(credential.tls, "connect")
    return {
        "transport/auth/usrpwd/user": credential.name,
        "transport/auth/usrpwd/password": credential.password,
    }
