"""Zenoh access control, derived from the key table.

The router forwards only what `bus.keys` grants a party and drops everything else. Zenoh drops messages silently, so the
session checks the same table first and raises `AccessDenied`.
"""

import base64
import contextlib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from bus.credentials import Credential, CredentialSet
from bus.errors import BusError
from bus.files import write_whole
from bus.identities import Identity
from bus.keys import (
    MAX_SESSIONS,
    SIMULATOR_NAME,
    Grant,
    Key,
    Party,
    Role,
    read_by,
    token,
    vehicle_token,
    written_by,
)
from bus.roles import Roles, own_grants, roles_among


def _expressions(key: Key, party: Party, run: str) -> str:
    """Return the keys of one row that a party may use: a vehicle's own key, else the keys of all vehicles."""
    return key.expression(run, party.name if party.role is key.vehicle else "*")


def grants(party: Party, run: str, extensions: Iterable[Roles] = ()) -> tuple[Grant, ...]:
    """Return everything that the router forwards for a party: the keys of the table, and liveliness tokens.

    Args:
        party: The party.
        run: Name of the run.
        extensions: Roles of extensions in the run.

    Raises:
        AccessDenied: If an extension grants a key of a run.
    """
    found = {grant for roles in extensions for grant in own_grants(roles, party)}
    for key in written_by(party):
        own = _expressions(key, party, run)
        found.add(Grant(message="put", flow="ingress", keys=(own,)))
        # # A publisher sends only once it knows of a subscriber; the simulator subscribes to all vehicles at once.
        declared_keys = tuple(dict.fromkeys((own, key.expression(run, "*"))))
        found.add(Grant(message="declare_subscriber", flow="egress", keys=declared_keys))
    for key in read_by(party):
        own = _expressions(key, party, run)
        found.add(Grant(message="declare_subscriber", flow="ingress", keys=(own,)))
        found.add(Grant(message="put", flow="egress", keys=(own,)))
    watched = token(run, "*" if party.role is Role.SIMULATOR else SIMULATOR_NAME, "*")
    own = token(run, party.name, "*")
    declared = tuple(token(run, party.name, number) for number in range(MAX_SESSIONS))
    if party.role is Role.SIMULATOR:
        declared += tuple(vehicle_token(run, "*", role) for role in (Role.UAV, Role.UGV))
    found.add(Grant(message="liveliness_token", flow="ingress", keys=declared))
    found.add(Grant(message="liveliness_query", flow="ingress", keys=(own,)))
    found.add(Grant(message="declare_liveliness_subscriber", flow="ingress", keys=(watched,)))
    found.add(Grant(message="liveliness_token", flow="egress", keys=(watched, own)))
    return tuple(sorted(found))


def access_control(given: CredentialSet) -> dict[str, Any]:
    """Return Zenoh's `access_control` for a run: deny everything except each party's grants."""
    by = "usernames" if given.tls is None else "cert_common_names"
    # The router knows the keys of an extension only if one of its parties has credentials.
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
    """Yield the settings with which a router authenticates its parties.

    Zenoh reads names and passwords from a file. It lies in a private folder that is removed on exit.

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
    """Return the settings of mutual TLS as the only protocol.

    Zenoh accepts PEM in base64, so that no key is written to a file.
    """

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
    """Return the settings with which a client authenticates itself."""
    if credential is None:
        return {}
    if credential.tls is not None:
        return _tls_settings(credential.tls, "connect")
    return {
        "transport/auth/usrpwd/user": credential.name,
        "transport/auth/usrpwd/password": credential.password,
    }
