"""Access to the page: token, proxies, security headers, and limits on a request's head."""

import asyncio
import hmac
import re
import secrets
from typing import Any, ClassVar, NamedTuple, cast

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from bus.locator import LOOPBACK
from outrider_dashboard.address import Access, address_among

LARGEST_HEAD = 16 << 10
"""Size limit of a request's head [bytes]."""
HEAD_TIMEOUT = 10.0
"""Time in which the first request of a connection must reach the guard [s]."""
MAX_PENDING = 256
"""Maximum number of connections whose first request has not reached the guard; one more closes the oldest."""
PREFIX_HEADER = "x-forwarded-prefix"
"""Header by which a proxy states the path under which it serves the page; NiceGUI reads it, too."""
_PREFIX = re.compile(r"(/[A-Za-z0-9._~-]+)*")
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


class Forwarded(NamedTuple):
    """Statement of a trusted proxy about a request."""

    prefix: str = ""
    """Path under which the proxy serves the page, such as `/outrider`."""
    secure: bool = False
    """True if the browser reaches the proxy over TLS."""


class Guard:
    """Middleware that checks the token, rejects requests from other sites, and sets the security headers.

    It reads the request as it arrived: decoding a hostile cookie or query can take seconds.

    Args:
        app: Application behind it.
        access: Access token, and the proxies whose `X-Forwarded-Prefix` and `X-Forwarded-Proto` are used.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self.app = app
        self._token = access.token.encode()
        self._proxies = access.proxies
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
        BoundedHead.release(scope.get("client"))
        request = HTTPConnection(scope)
        forwarded = self._forwarded(request)
        response = self._reject(request, forwarded)
        if response is None:
            await self.app(_behind_proxy(scope, forwarded), receive, send_secured)
            return
        response.headers.update({"Cache-Control": "no-store", "Connection": "close"})
        if scope["type"] == "websocket":
            await receive()  # the opening message precedes a rejection
        await response(scope, receive, send_secured)

    def _forwarded(self, request: HTTPConnection) -> Forwarded:
        """Return what a trusted proxy states; nothing if the request comes from another address."""
        if request.client is None or not address_among(request.client.host, self._proxies):
            return Forwarded()
        prefix = request.headers.get(PREFIX_HEADER, "").rstrip("/")
        scheme = request.headers.get("x-forwarded-proto", "").partition(",")[0].strip()
        return Forwarded(
            prefix if _PREFIX.fullmatch(prefix) else "", scheme.lower() in ("https", "wss")
        )

    def _reject(self, request: HTTPConnection, forwarded: Forwarded) -> Response | None:
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
        query = request.scope["query_string"].decode("latin-1")
        if self._matches(_values(query, "&", "token"), self._token):
            response = RedirectResponse(f"{forwarded.prefix}/", 303)
            response.set_cookie(
                name,
                self._cookie,
                path=forwarded.prefix or "/",
                secure=forwarded.secure,
                httponly=True,
                samesite="strict",
            )
            return response
        cookies = ";".join(request.headers.getlist("cookie"))
        if self._matches(_values(cookies, ";", name), self._cookie.encode()):
            return None
        return PlainTextResponse(
            "Open the page with the address printed by Outrider; it ends with ?token=...", 401
        )

    @staticmethod
    def _matches(values: list[str], secret: bytes) -> bool:
        """Return whether a value is the secret."""
        return any(hmac.compare_digest(value.encode(), secret) for value in values)


def _values(text: str, separator: str, name: str) -> list[str]:
    """Return the values of a name in a query or a cookie header, as they arrived.

    Tokens and our own cookies have no character that browsers encode or quote.
    """
    pairs = (part.strip().partition("=") for part in text.split(separator))
    return [value for key, _, value in pairs if key == name]


def _behind_proxy(scope: Scope, forwarded: Forwarded) -> Scope:
    """Return the scope of an admitted request, with the statement of a trusted proxy and of no other client."""
    headers = [row for row in scope["headers"] if row[0] != PREFIX_HEADER.encode()]
    if forwarded.prefix:
        headers.append((PREFIX_HEADER.encode(), forwarded.prefix.encode()))
    secure = {"scheme": "wss" if scope["type"] == "websocket" else "https"}
    return {**scope, "headers": headers, **(secure if forwarded.secure else {})}


class BoundedHead(asyncio.Protocol):
    """Reader of a connection's first request head, with limits on size and time; uvicorn reads the rest.

    uvicorn limits neither the time to the first request nor a head that arrives in one piece, and it never answers a
    WebSocket's head with a line beyond 8 KiB. A rejected request closes its connection, so later heads come from
    visitors with the token.

    Args:
        arguments: Keyword arguments of uvicorn's protocol.
    """

    _pending: ClassVar[dict[Any, tuple["BoundedHead", asyncio.TimerHandle]]] = {}
    # By the client's address and port, in order of arrival.

    def __init__(self, **arguments: Any) -> None:  # noqa: ANN401 - uvicorn's own
        self._arguments = arguments
        self._received = b""

    @classmethod
    def release(cls, client: tuple[str, int] | None) -> None:
        """Stop the timer of a client whose request has reached the guard."""
        if (found := cls._pending.pop(client, None)) is not None:
            found[1].cancel()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the timer; close the oldest connection if too many are pending."""
        self._transport = cast("asyncio.Transport", transport)
        peer = transport.get_extra_info("peername")
        self._client = peer[:2] if peer else (repr(self), 0)  # no address: the client has left
        if len(self._pending) >= MAX_PENDING:
            next(iter(self._pending.values()))[0]._close()
        timer = asyncio.get_running_loop().call_later(HEAD_TIMEOUT, self._close)
        self._pending[self._client] = self, timer

    def data_received(self, data: bytes) -> None:
        """Pass a complete head to uvicorn; reject a head that is too large."""
        self._received += data
        if b"\r\n\r\n" in self._received[:LARGEST_HEAD]:
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
        self.release(self._client)

    def _close(self) -> None:
        self.release(self._client)
        self._transport.close()
