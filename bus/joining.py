"""Joining and leaving the bus, as its router or as a client."""

import json
import logging
import os
import resource
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import zenoh

from bus.access import client_settings, router_settings
from bus.credentials import ROUTER_FILE, Credential, CredentialSet
from bus.errors import AccessDenied, BusError
from bus.identities import Identity, expiry_warning, find_fault
from bus.keys import KEYS, Party, check_run_name, largest_payloads, read_by, written_by
from bus.locator import UNIX, Locator, check_endpoint
from bus.session import Session

_LOG = logging.getLogger("outrider.bus")
_LARGE = 1 << 20
"""Minimum size limit of payloads [bytes]: keys of extensions may carry this much."""
_OPENED_IN: set[int] = set()
"""Ids of this process and of its fork ancestors that have opened a session."""
_PROBED = ("tcp", "tls", "ws", UNIX)
"""Protocols for which a plain connection shows that a router listens."""
_PROBE = 0.05
"""Interval at which a client checks whether its router listens [s]."""
_HEADER = 4096
"""Size of a message's frame in addition to its payload [bytes]."""

_COMMON: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
}
_CLIENT: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": 10_000,
    "connect/exit_on_failure": True,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 2},
    "transport/link/tx/lease": 1000,
    "transport/unicast/open_timeout": 3000,
}
_ROUTER: dict[str, Any] = {
    "mode": "router",
    "listen/exit_on_failure": True,
    # Silent connections must not keep other clients out: by default 100 of them do so for 10 s.
    "transport/unicast/accept_pending": 2000,
    "transport/unicast/accept_timeout": 2000,
    "transport/unicast/max_sessions": 1000,
}


def _config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


def _reason(error: zenoh.ZError) -> str:
    """Return Zenoh's reason without the position in its source."""
    return str(error).splitlines()[0].rpartition(" at /")[0] or str(error)


def _received(largest: int) -> dict[str, Any]:
    """Return settings that drop larger messages before their fragments are assembled."""
    return {"transport/link/rx/max_message_size": largest + _HEADER}


def _dropped(run: str) -> dict[str, Any]:
    """Return settings that drop payloads larger than their key allows, before an inbox stores them."""
    return {
        "low_pass_filter": [
            {
                "id": f"largest-{size}",
                "flows": ["ingress"],
                "messages": ["put", "delete", "query", "reply"],
                "key_exprs": list(expressions),
                "size_limit": size,
            }
            for size, expressions in largest_payloads(run).items()
        ]
    }


def _allow_open_files() -> None:
    """Raise the limit of open files to this user's maximum.

    Each connection is one file: at a limit of 1,024, silent connections keep other clients out.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _open_router(
    listen: tuple[str, ...], party: Party, run: str, given: CredentialSet | None
) -> zenoh.Session:
    _allow_open_files()
    largest = max(_LARGE, *(key.largest for key in KEYS if key.writer is not party.role))
    with router_settings(given) as access:
        settings = (
            _COMMON
            | _ROUTER
            | _received(largest)
            | _dropped(run)
            | access
            | {"listen/endpoints": list(listen)}
        )
        try:
            return zenoh.open(_config(settings))
        except zenoh.ZError as error:
            raise BusError(f"cannot listen on {', '.join(listen)}: {_reason(error)}") from error


def _explained(
    endpoint: str, credential: Credential, identity: Identity, error: BusError
) -> BusError:
    """Return an error that explains why the router rejects a certificate; Zenoh reports only a failed connection."""
    found = Locator.of(endpoint)
    try:
        fault = find_fault(found.host, int(found.port), identity)
    except OSError:
        return error
    return AccessDenied(
        f"the router at {endpoint} {fault or 'rejects this process'} (as {credential.name})"
    )


def _check_protocol(endpoints: tuple[str, ...], *, certified: bool) -> None:
    """Check that the endpoints match the credentials, and that nothing is sent unencrypted.

    Raises:
        AccessDenied: If an endpoint and the credentials do not match.
    """
    for endpoint in endpoints:
        if certified and not endpoint.startswith("tls/"):
            raise AccessDenied(
                f"endpoint {endpoint}: must begin with tls/, because the credentials are certificates"
            )
        if endpoint.startswith("tls/") and not certified:
            raise AccessDenied(
                f"endpoint {endpoint}: requires certificates; make them with `outrider credentials --tls`"
            )


def _check_certificate(identity: Identity, name: str) -> None:
    from bus.certificates import check_identity  # noqa: PLC0415 - the extra [tls]

    warning = expiry_warning(name, check_identity(identity, name))
    if warning:
        _LOG.warning("%s", warning)


def _await_router(router: Locator, endpoint: str, join_timeout: float) -> None:
    """Wait until the router accepts connections. Signals interrupt this wait, but not Zenoh's own.

    Raises:
        BusError: If it does not do so in time.
    """
    limit = time.monotonic() + join_timeout
    while fault := router.connection_fault():
        if time.monotonic() >= limit:
            raise BusError(f"no router at {endpoint} within {join_timeout:g} s: {fault}")
        time.sleep(_PROBE)


def _open_client(
    connect: str, party: Party, credential: Credential | None, join_timeout: float | None
) -> zenoh.Session:
    router = Locator.of(connect)
    limit = _CLIENT["connect/timeout_ms"]
    if join_timeout is not None:
        wanted = round(1000.0 * join_timeout)
        if router.protocol in _PROBED:
            _await_router(router, connect, join_timeout)
            # A listening router rejects this process for good, or is overloaded for a while.
            limit = min(wanted, limit)
        else:
            limit = wanted
    largest = max((_LARGE, *(key.largest for key in (*read_by(party), *written_by(party)))))
    settings = _COMMON | _CLIENT | _received(largest) | client_settings(credential)
    settings |= {"connect/endpoints": [connect], "connect/timeout_ms": limit}
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError as error:
        missing = f"no router at {connect} within {limit / 1000.0:g} s"
        if router.protocol not in _PROBED:
            raise BusError(f"{missing} ({_reason(error)})") from error
        fault = router.connection_fault()
        if fault:
            raise BusError(f"{missing}: {fault}") from error
        if credential is not None and credential.tls is not None:
            raise _explained(connect, credential, credential.tls, BusError(missing)) from error
        who = (
            "without credentials"
            if credential is None
            else f"as {credential.name}: check the run's password, and that a router listens there"
        )
        raise AccessDenied(f"{connect} accepts connections, but not this process {who}") from error


def _refuse_fork() -> None:
    """Reject a forked process whose parent has opened a session: Zenoh would wait forever for threads of the parent.

    Raises:
        BusError: If this process is one.
    """
    if _OPENED_IN - {os.getpid()}:
        raise BusError(
            "a forked process cannot join the bus after its parent has; allowed: a process started by another "
            "method, such as multiprocessing.get_context('spawn')"
        )
    _OPENED_IN.add(os.getpid())


@contextmanager
def open_session(
    party: Party,
    run: str,
    *,
    connect: str = "",
    listen: tuple[str, ...] = (),
    credential: Credential | None = None,
    given: CredentialSet | None = None,
    join_timeout: float | None = None,
) -> Iterator[Session]:
    """Join the bus.

    Args:
        party: Identity of this process.
        run: Name of the run.
        connect: Endpoint of the router, such as `tcp/127.0.0.1:7447`; this process is then its client.
        listen: Endpoints to listen on; this process is then the router.
        credential: Credential of a client.
        given: Credentials of all clients, for the router; None: no access control.
        join_timeout: Time for which a client tries to reach an absent router [s]; None: 10 s. A router that rejects the
            client is tried for at most 10 s.

    Raises:
        ValueError: If the run's name cannot be part of a key.
        ScenarioError: If an endpoint is invalid, or its host has no address.
        BusError: If the router cannot be reached, an endpoint cannot be opened, or this process was forked from one
            that has opened a session.
        AccessDenied: If the router rejects the credential, it does not match the endpoint, or its certificate is
            invalid.
    """
    check_run_name(run)
    if credential is not None and credential.party != party:
        raise AccessDenied(
            f"{party.name} ({party.role}) cannot use the credentials of {credential.name} ({credential.role})"
        )
    if listen:
        name, identity = ROUTER_FILE, None if given is None else given.tls
    else:
        name, identity = party.name, None if credential is None else credential.tls
    _check_protocol(listen or (connect,), certified=identity is not None)
    for endpoint in listen or (connect,):
        check_endpoint(endpoint)
    _refuse_fork()
    if identity is not None:
        _check_certificate(identity, name)
    opened = (
        _open_router(listen, party, run, given)
        if listen
        else _open_client(connect, party, credential, join_timeout)
    )
    session = Session(opened, party, run, hosts=bool(listen))
    if listen and given is not None and given.tls is not None:
        session.report_unknown_certificates(frozenset(one.name for one in given.parties))
    try:
        yield session
    finally:
        session.close()
        try:
            opened.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:  # all messages have been sent
            _LOG.warning("the session did not close in time: %s", str(error).partition(" at /")[0])
