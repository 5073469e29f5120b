"""Work of `outrider dashboard --replay`: the page of a recording."""

from pathlib import Path

from outrider.cli.console import ERR
from outrider.recording.reader import flight_of
from outrider_dashboard.address import Access, address_of, open_socket
from outrider_dashboard.app import serve
from outrider_dashboard.controls.player import Player
from outrider_dashboard.hub import Hub
from outrider_dashboard.sources.recorded import RecordedRun
from sim.scenario.resolved import as_toml


def show_recording(
    file: Path, flight: int | None, speed: float, host: str, port: int, access: Access
) -> None:
    """Serve the page of a recording, played at `speed` [simulated seconds per second]."""
    recording = flight_of(file, flight)
    with open_socket(host, port) as opened:
        recorded = RecordedRun(recording, speed)
        known = "" if recording.head.scenario is None else as_toml(recording.scenario)
        hub = Hub(recorded, scenario=known)
        line = (
            f"dashboard of {recording.path}: {address_of(opened, access.token)} (stop with Ctrl-C)"
        )
        serve(
            hub,
            opened,
            access,
            controls=lambda: Player(hub, recorded).show,
            ready=lambda: ERR.tell(line),
        )
