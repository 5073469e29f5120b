"""Headers of every response.

What may run in the page, and that nobody may frame, guess or follow it.
"""

import base64
import hashlib
import re
import secrets
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from outrider.view.page.access.login import FORM_STYLE

_PAGE = "x-nicegui-content"
"""NiceGUI's header of a page, and of nothing else."""
_HIDDEN = "display: none"
"""The one style attribute of NiceGUI's page."""
_TAG = re.compile(rb"<(script|style)(?=[\s>])")
_START = ("http.response.start", "websocket.http.response.start")
_NOWHERE = "base-uri 'none'; frame-ancestors 'none'"


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


_OTHERWISE = f"default-src 'none'; style-src {_hash(FORM_STYLE)}; img-src 'self'; form-action 'self'; {_NOWHERE}"
"""For all but the page: nothing runs, but the form that asks for the token has its style."""
_FIXED = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def page_policy(nonce: str) -> str:
    """Content-Security-Policy of the page.

    'unsafe-eval' remains: NiceGUI's components are templates that Vue compiles in the browser, and its handlers are
    text. Scripts and styles in the page's text run by the nonce alone, so what finds its way into the text does not.
    """
    return (
        f"default-src 'none'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
        f"style-src 'self' 'nonce-{nonce}'; style-src-attr 'unsafe-hashes' {_hash(_HIDDEN)}; "
        f"img-src 'self' data:; font-src 'self'; connect-src 'self'; form-action 'none'; {_NOWHERE}"
    )


class SecureHeaders:
    """Adds to every response what browsers must know of it.

    Args:
        app: What responds.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        """The application that responds."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Respond, with the headers."""

        async def tell(message: Message) -> None:
            if message["type"] in _START:
                headers = MutableHeaders(scope=message)
                for name, value in _FIXED.items():
                    headers[name] = value
                headers.setdefault("Content-Security-Policy", _OTHERWISE)
            await send(message)

        await self.app(scope, receive, tell)


class Nonces:
    """Marks the scripts and styles of NiceGUI's page as its own, with a number that is used once.

    Args:
        app: What builds the page, and does not compress it.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        """The function that builds the page."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass all on; a page is held until it is whole."""
        start: dict[str, Any] = {}
        parts: list[bytes] = []

        async def mark(message: Message) -> None:
            if message["type"] == "http.response.start" and _is_page(message):
                start.update(message)
            elif start and message["type"] == "http.response.body":
                parts.append(message.get("body", b""))
                if not message.get("more_body", False):
                    await _send_marked(start, b"".join(parts), send)
                    start.clear()
            else:
                await send(message)

        await self.app(scope, receive, mark)


def _is_page(message: Message) -> bool:
    headers = MutableHeaders(scope=message)
    return _PAGE in headers and headers.get("content-type", "").startswith("text/html")


async def _send_marked(start: Message, body: bytes, send: Send) -> None:
    nonce = secrets.token_urlsafe(18)
    marked = _TAG.sub(rb'<\1 nonce="' + nonce.encode() + rb'"', body)
    headers = MutableHeaders(scope=start)
    headers["Content-Security-Policy"] = page_policy(nonce)
    headers["Content-Length"] = str(len(marked))
    await send({**start, "headers": headers.raw})
    await send({"type": "http.response.body", "body": marked})
