"""The web server: the page, its files, and a channel of frames to each browser."""

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
from bus.messages.decision import WHAT_HAPPENED
from outrider.running.metrics import LINK, MISSION, NOW, PROCESS
from outrider_dashboard.hub import Browser, Hub
from outrider_dashboard.page_guard import LARGEST_HEAD, BoundedHead, Guard
from outrider_dashboard.shell import BuildControls, build_page
from outrider_dashboard.themes import drawn, style

METRICS = {
    name: list(table.values())
    for name, table in (("now", NOW), ("mission", MISSION), ("link", LINK), ("process", PROCESS))
}
"""Tables of metrics from which the page takes labels, units, digits and meanings."""
STATIC = Path(__file__).with_name("static")


class PageMessage(msgspec.Struct, forbid_unknown_fields=True):
    """A message from a page."""

    kind: str
    """`drawn`, `here`, `take`, `back` or `drive`."""
    deflection: Vector | None = None
    vehicle: str = ""


_WORDS = msgspec.json.Decoder(PageMessage)


class _Fresh(StaticFiles):
    """Files that a browser asks for again, so that a new version shows."""

    async def get_response(self, path: str, scope: MutableMapping[str, Any]) -> Response:
        """The file."""
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


def serve(
    hub: Hub,
    listening: socket.socket,
    token: str,
    *,
    controls: BuildControls | None,
    ready: Callable[[], None],
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        hub: What is shown.
        listening: The socket to serve on.
        token: Token that opens the page; empty: none is needed.
        controls: Builds what can be touched in a page; None: nothing.
        ready: Called when browsers can come.
    """
    app = application(hub, token, controls=controls, ready=ready)
    web_server(app).run(sockets=[listening])


def web_server(app: ASGIApp) -> uvicorn.Server:
    """Return a server of an application, with bounds on requests."""
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
    hub: Hub, token: str, *, controls: BuildControls | None, ready: Callable[[], None]
) -> ASGIApp:
    """Return the guarded application; once a process, as NiceGUI exists once. Arguments as of `serve`."""

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

    app.mount("/static", _Fresh(directory=STATIC))

    @app.websocket("/frames")
    async def frames(channel: WebSocket) -> None:
        await _accompany(hub, channel)

    build_page(controls)
    ui.run_with(
        app,
        title="Outrider",
        favicon=STATIC / "favicon.svg",
        dark=None,
        show_welcome_message=False,
        tailwind=False,
    )
    return Guard(app, token)


async def _accompany(hub: Hub, channel: WebSocket) -> None:
    """Frames to one browser and words from it, until it has gone."""
    await channel.accept()
    browser = hub.welcome(channel.client.host if channel.client else "")
    sending = asyncio.create_task(_send_frames(hub, browser, channel))
    try:
        async for text in _words(channel):
            _obey(hub, browser, text)
    finally:
        sending.cancel()
        hub.leave(browser)


async def _words(channel: WebSocket) -> AsyncIterator[str]:
    """All that a browser says. Where it has gone while a frame was sent to it, that is a RuntimeError here."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, KeyError):
        while True:
            yield await channel.receive_text()


async def _send_frames(hub: Hub, browser: Browser, channel: WebSocket) -> None:
    hello = {
        "kind": "hello",
        "number": browser.number,
        "colors": drawn(),
        "steer": hub.source.may_steer,
        "metrics": METRICS,
        "reasons": WHAT_HAPPENED,
    }
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        await channel.send_text(msgspec.json.encode(hello).decode())
        while True:
            await browser.turn.wait()
            browser.turn.clear()
            await channel.send_text(hub.frame(browser).decode())


def _obey(hub: Hub, browser: Browser, text: str) -> None:
    try:
        word = _WORDS.decode(text)
    except msgspec.DecodeError:
        return
    hub.wheel.keep(browser.number)
    match word.kind:
        case "drawn":
            browser.in_hand = max(0, browser.in_hand - 1)
        case "take" if word.vehicle in hub.drivers:
            hub.wheel.take(browser.number, browser.name, word.vehicle)
        case "back":
            hub.wheel.hand_back(browser.number)
        case "drive":
            hub.wheel.steer(browser.number, word.deflection)
