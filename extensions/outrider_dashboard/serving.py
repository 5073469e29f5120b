"""Work of `outrider dashboard`: the page of a run."""

import socket
import sys

from outrider.cli.console import ERR
from outrider.cli.joining import Joining
from outrider.running.parent import Start
from outrider_dashboard.address import Access, address_of
from outrider_dashboard.app import serve
from outrider_dashboard.controls.run_card import Controls
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.live import LiveRun


def show_run(
    joining: Joining,
    opened: socket.socket,
    access: Access,
    start: Start | None,
    scenario: str = "",
) -> None:
    """Serve the page of a run; as a child process, report on standard output when it is ready and over.

    Args:
        joining: Run to join.
        opened: Socket to serve on.
        access: Access token and trusted proxies.
        start: Input of a child process; None: started by the user.
        scenario: Resolved scenario as TOML, if the user names it.
    """
    line = f"dashboard of the run: {address_of(opened, access.token)}"

    def report(text: str) -> None:
        if start is None:
            ERR.tell(text)
        else:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()

    def on_end() -> None:
        if start is not None:
            report("over")

    with joining.session() as session:
        known = scenario if start is None else start.scenario
        hub = Hub(LiveRun(session), None if start is None else start.law, on_end, known)
        controls = (lambda: Controls(hub).show) if hub.source.may_steer else None
        serve(hub, opened, access, controls=controls, ready=lambda: report(line))
