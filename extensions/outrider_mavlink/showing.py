"""Work of `outrider mavlink`: a run in ground stations."""

import time
from typing import Any

from bus.errors import PeerLost
from bus.keys import SAMPLED_TRUTH, STATUS
from bus.session import Session
from outrider.cli.console import ERR
from outrider.cli.joining import Joining
from outrider.cli.stopping import Stop
from outrider.cli.waiting import RouterTimer, await_status
from outrider.view.operator import SILENCE, RunClient
from outrider_mavlink.run_gateway import RunGateway
from outrider_mavlink.udp import Network

_LINGER = 0.6
"""Time for which the gateway continues after the end of a run, in case of a reset [s]."""
_TURN = 0.02
"""Maximum time between two updates from the run [s]."""


def show(
    network: Network,
    joining: Joining,
    stop: Stop,
    first: int,
    height: float,
) -> dict[str, Any]:
    """Serve a run until it ends or the user stops the command; return the counts."""
    with joining.session() as session:
        status = await_status(session, stop)
        if status is None:
            return {"vehicles": {}}
        client = RunClient(session, status, read=(STATUS, SAMPLED_TRUTH))
        gateway = RunGateway(client, network, status, first=first, height=height)
        named = {system.name: number for number, system in gateway.systems.items()}
        ERR.tell(
            f"run {joining.run}: {', '.join(f'system {n} is {name}' for name, n in named.items())}"
        )
        try:
            lost = _follow(session, client, gateway, stop)
        finally:
            gateway.close()
    if lost:
        raise PeerLost(f"the router at {joining.connect} disconnected")
    return {"vehicles": named, **gateway.counts()}


def _follow(session: Session, client: RunClient, gateway: RunGateway, stop: Stop) -> bool:
    """Serve the run until it ends or the user stops it; return True if the router disconnected."""
    over_since, router = None, RouterTimer(session)
    while not stop:
        for message in client.news():
            gateway.take(message)
        gateway.silent = client.age > SILENCE  # without news, send no telemetry
        gateway.turn(_TURN)
        now = time.monotonic()
        over = client.status is not None and client.status.over
        over_since = (over_since or now) if over else None
        if over_since is not None and now - over_since > _LINGER:
            return False
        if router.has_gone():
            return True
    return False
