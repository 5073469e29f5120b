"""Access to the page: token, security headers, and limits on a request's head."""

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
MAX_PENDING = 256
"""Maximum number of connections without a complete head; one more closes the oldest."""
_HEADERS = {
    # NiceGUI's page has inline scripts and styles, and Vue compiles its templates in the browser. Event handlers in
    # attributes and scripts from other servers do not run.
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
    """Middleware that checks the token, rejects requests from other sites, and sets the security headers.

    Args:
        app: Application behind it.
        token: Access token; empty: admit every browser on this machine.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app = app
        self._token = token.encode()
        self._cookie = secrets.token_urlsafe(
            32
        )  # ends with the process, and does not reveal the token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request, or reject it."""

        async def send_secured(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        response = self._reject(HTTPConnection(scope))
        if response is None:
            await self.app(scope, receive, send_secured)
            return
        response.headers.update({"Cache-Control": "no-store", "Connection": "close"})
        if scope["type"] == "websocket":
            await receive()  # the opening message precedes a rejection
        await response(scope, receive, send_secured)

    def _reject(self, request: HTTPConnection) -> Response | None:
        """Return the response to a rejected request; None if it is admitted."""
        host = request.headers.get("host", "").lower()
        sites = request.headers.getlist("sec-fetch-site")
        origins = request.headers.getlist("origin")
        if not all(site in ("same-origin", "none") for site in sites) or not all(
            origin.lower() in (f"http://{host}", f"https://{host}") for origin in origins
        ):
            return PlainTextResponse(
                "Requests from other sites are rejected: open the page by its address.", 403
            )
        if not self._token:
            # Against DNS rebinding: another site could resolve its own name to 127.0.0.1.
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
            "Open the page with the address printed by Outrider; it ends with ?token=...", 401
        )


class BoundedHead(asyncio.Protocol):
    """Reader of a connection's first request head, with limits on size and time; uvicorn reads the rest.

    uvicorn limits neither the time to the first request nor a head that arrives in one piece. A rejected request
    closes its connection, so later heads come from visitors with the token.

    Args:
        arguments: Keyword arguments of uvicorn's protocol.
    """

    _pending: ClassVar[dict["BoundedHead", asyncio.TimerHandle]] = {}  # in order of arrival

    def __init__(self, **arguments: Any) -> None:  # noqa: ANN401 - uvicorn's own
        self._arguments = arguments
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the timer; close the oldest connection if too many are pending."""
        self._transport = cast("asyncio.Transport", transport)
        if len(self._pending) >= MAX_PENDING:
            next(iter(self._pending))._close()
        timer = asyncio.get_running_loop().call_later(HEAD_TIMEOUT, self._close)
        self._pending[self] = timer

    def data_received(self, data: bytes) -> None:
        """Pass a complete head to uvicorn; reject a head that is too large."""
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
        """Stop the timer."""
        self._forget()

    def _close(self) -> None:
        self._forget()
        self._transport.close()

    def _forget(self) -> None:
        if timer := self._pending.pop(self, None):
            timer.cancel()
