"""Access to the page: the token, the security headers, and bounds on a request's head."""

import asyncio
import hmac
import re
import secrets
from typing import Any, ClassVar, cast

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from bus.locator import LOOPBACK

LARGEST_HEAD = 16 << 10
"""Size limit of a request's head [bytes]."""
HEAD_TIMEOUT = 10.0
"""Time in which a connection must send its first head [s]."""
MOST_WAITING = 256
"""Connections without a complete head; one more closes the oldest."""
_HEADERS = {
    # NiceGUI's page has inline scripts and styles, and Vue compiles its templates in the browser. Event handlers in
    # attributes and scripts from elsewhere do not run.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; script-src-attr 'none'; "
        "style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self'; connect-src 'self'; "
        "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """Middleware that lets in requests with the token, refuses other sites, and sets the security headers.

    Args:
        app: Application behind it.
        token: Token that opens the page; empty: every browser of this machine is let in.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app = app
        self._token = token.encode()
        self._cookie = secrets.token_urlsafe(
            32
        )  # ends with the process, and does not reveal the token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""

        async def send_secured(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        response = self._refuse(HTTPConnection(scope))
        if response is None:
            await self.app(scope, receive, send_secured)
            return
        response.headers.update({"Cache-Control": "no-store", "Connection": "close"})
        if scope["type"] == "websocket":
            await receive()  # the opening message comes before a refusal
        await response(scope, receive, send_secured)

    def _refuse(self, request: HTTPConnection) -> Response | None:
        """Return the response in the application's place; None: let it in."""
        host = request.headers.get("host", "").lower()
        sites = request.headers.getlist("sec-fetch-site")
        origins = request.headers.getlist("origin")
        if not all(site in ("same-origin", "none") for site in sites) or not all(
            origin.lower() in (f"http://{host}", f"https://{host}") for origin in origins
        ):
            return PlainTextResponse("Not from another site: open the page by its address.", 403)
        if not self._token:
            # Otherwise another site could have its own name resolved to 127.0.0.1.
            local = re.sub(r":\d+$", "", host).strip("[]") in LOOPBACK
            return None if local else PlainTextResponse("Unknown host.", 403)
        name = f"outrider_{(request.scope.get('server') or ('', 0))[1]}"  # cookies ignore ports
        token = request.query_params.get("token", "")
        if token and hmac.compare_digest(token.encode(), self._token):
            response = RedirectResponse("/", 303)
            response.set_cookie(name, self._cookie, httponly=True, samesite="strict")
            return response
        if hmac.compare_digest(request.cookies.get(name, "").encode(), self._cookie.encode()):
            return None
        return PlainTextResponse(
            "Open the page by the address that Outrider has printed: it ends with ?token=...", 401
        )


class BoundedHead(asyncio.Protocol):
    """Reader of a connection's first request head, within bounds of size and time; uvicorn reads the rest.

    uvicorn bounds neither the time to the first request nor a head that arrives at once. A refused request closes its
    connection, so later heads are those of visitors with the token.

    Args:
        arguments: Keyword arguments of uvicorn's protocol.
    """

    _waiting: ClassVar[dict["BoundedHead", asyncio.TimerHandle]] = {}  # in order of arrival

    def __init__(self, **arguments: Any) -> None:  # noqa: ANN401 - uvicorn's own
        self._arguments = arguments
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the clock, and close the oldest connection if too many wait."""
        self._transport = cast("asyncio.Transport", transport)
        if len(self._waiting) >= MOST_WAITING:
            next(iter(self._waiting))._close()
        timer = asyncio.get_running_loop().call_later(HEAD_TIMEOUT, self._close)
        self._waiting[self] = timer

    def data_received(self, data: bytes) -> None:
        """Hand a complete head to uvicorn; refuse one that is too large."""
        self._received += data
        if b"\r\n\r\n" in self._received[:LARGEST_HEAD]:
            self._forget()
            server = H11Protocol(**self._arguments)
            server.connection_made(self._transport)
            self._transport.set_protocol(server)
            server.data_received(self._received)
        elif len(self._received) > LARGEST_HEAD:
            self._transport.write(
                b"HTTP/1.1 431 Request Header Fields Too Large\r\nConnection: close\r\n\r\n"
            )
            self._close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._forget()

    def _close(self) -> None:
        self._forget()
        self._transport.close()

    def _forget(self) -> None:
        if timer := self._waiting.pop(self, None):
            timer.cancel()
