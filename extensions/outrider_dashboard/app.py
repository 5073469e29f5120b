"""Web server: the page, its files, and one WebSocket for each browser."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable, MutableMapping
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from fastapi import FastAPI
from nicegui import ui
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from bus.messages.base import Vector
from bus.messages.control import Action, Control
from bus.messages.decision import WHAT_HAPPENED
from bus.messages.team import Request as TeamRequest
from outrider.running.metrics import LINK, MISSION, NOW, PROCESS
from outrider_dashboard.address import Access
from outrider_dashboard.hub import Browser, Hub
from outrider_dashboard.page_guard import LARGEST_HEAD, BoundedHead, Guard
from outrider_dashboard.shell import BuildControls, build_page
from outrider_dashboard.themes import palettes, style

METRICS = {
    name: list(table.values())
    for name, table in (("now", NOW), ("mission", MISSION), ("link", LINK), ("process", PROCESS))
}
"""Tables of metrics: labels, units, digits and descriptions shown by the page."""
STATIC = Path(__file__).with_name("static")


class PageMessage(msgspec.Struct, forbid_unknown_fields=True):
    """Message from a page."""

    kind: str
    """`drawn`, `here`, `take`, `back`, `drive` or `request`."""
    deflection: Vector | None = None
    vehicle: str = ""
    request: TeamRequest | None = None
    """Request to a UAV of a team."""


_DECODER = msgspec.json.Decoder(PageMessage)


class _UncachedFiles(StaticFiles):
    """Static files that browsers revalidate, so that they load new versions."""

    async def get_response(self, path: str, scope: MutableMapping[str, Any]) -> Response:
        """Return the file with a header that disables caching."""
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


def serve(
    hub: Hub,
    listening: socket.socket,
    access: Access,
    *,
    controls: BuildControls | None,
    ready: Callable[[], None],
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        hub: State of the run and its browsers.
        listening: Socket to serve on.
        access: Access token and trusted proxies.
        controls: Builds the controls of a page; None: a page without controls.
        ready: Called when the server accepts browsers.
    """
    app = application(hub, access, controls=controls, ready=ready)
    web_server(app).run(sockets=[listening])


def web_server(app: ASGIApp) -> uvicorn.Server:
    """Return a server for an application, with limits on request size and time."""
    config = uvicorn.Config(
        app,
        lifespan="on",
        log_level="warning",
        access_log=False,
        http=BoundedHead,
        h11_max_incomplete_event_size=LARGEST_HEAD,
        proxy_headers=False,
        server_header=False,
        ws_per_message_deflate=False,
        ws_max_size=1 << 20,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)


def application(
    hub: Hub, access: Access, *, controls: BuildControls | None, ready: Callable[[], None]
) -> ASGIApp:
    """Return the application behind its guard; arguments as for `serve`.

    Call it once per process: NiceGUI has one global application.
    """

    @contextlib.asynccontextmanager
    async def living(_app: FastAPI) -> AsyncIterator[None]:
        following = asyncio.create_task(hub.follow())
        ready()
        yield
        following.cancel()
        hub.close()

    app = FastAPI(lifespan=living, docs_url=None, redoc_url=None, openapi_url=None)

    @app.get("/static/colors.css")
    def colors() -> Response:
        return Response(style(), media_type="text/css", headers={"Cache-Control": "no-cache"})

    app.mount("/static", _UncachedFiles(directory=STATIC))

    @app.websocket("/frames")
    async def frames(channel: WebSocket) -> None:
        await _serve_browser(hub, channel)

    build_page(hub, controls)
    ui.run_with(
        app,
        title="Outrider",
        favicon=STATIC / "favicon.svg",
        dark=None,
        show_welcome_message=False,
        tailwind=False,
    )
    return Guard(app, access)


async def _serve_browser(hub: Hub, channel: WebSocket) -> None:
    """Send frames to a browser and handle its messages until it disconnects."""
    await channel.accept()
    browser = hub.add_browser(channel.client.host if channel.client else "")
    sending = asyncio.create_task(_send_frames(hub, browser, channel))
    try:
        async for text in _messages(channel):
            _handle(hub, browser, text)
    finally:
        sending.cancel()
        hub.remove_browser(browser)


async def _messages(channel: WebSocket) -> AsyncIterator[str]:
    """Yield the messages of a browser; receiving raises RuntimeError if it disconnected during a send."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, KeyError):
        while True:
            yield await channel.receive_text()


async def _send_frames(hub: Hub, browser: Browser, channel: WebSocket) -> None:
    hello = {
        "kind": "hello",
        "number": browser.number,
        "colors": palettes(),
        "steer": hub.source.may_steer,
        "metrics": METRICS,
        "reasons": WHAT_HAPPENED,
    }
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await channel.send_text(msgspec.json.encode(hello).decode())
        while True:
            await browser.ready.wait()
            browser.ready.clear()
            await channel.send_text(hub.frame(browser).decode())


def _handle(hub: Hub, browser: Browser, text: str) -> None:
    try:
        message = _DECODER.decode(text)
    except msgspec.DecodeError:
        return
    hub.teleoperation.mark_alive(browser.number)
    match message.kind:
        case "drawn":
            browser.undrawn = max(0, browser.undrawn - 1)
        case "take" if message.vehicle in hub.drivers:
            hub.teleoperation.take_control(browser.number, browser.name, message.vehicle)
        case "back":
            hub.teleoperation.hand_back(browser.number)
        case "request" if message.request is not None and hub.has_uav(message.vehicle):
            hub.source.control(
                Control(action=Action.REQUEST, vehicle=message.vehicle, request=message.request)
            )
        case "drive":
            hub.teleoperation.steer(browser.number, message.deflection)
