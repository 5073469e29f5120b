"""Who may look at the page: whoever has the token, or this machine's own browsers where there is none.

Without a token only pages that were asked for by a loopback name are served, and no other site's page may open a connection:
otherwise any page in the same browser could take the wheel.
"""

import asyncio
import hashlib
import hmac
from collections.abc import MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from outrider.dashboard import LOOPBACK

_SLOWLY = 0.5
"""A wrong token costs this much time [s]."""
_LARGEST = 4096
"""Of a form [bytes]."""

_FORM = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Outrider</title><style>body{{font:16px/1.5 system-ui,sans-serif;background:#f4f5f7;color:#22262d;display:grid;
place-items:center;min-height:90vh}}form{{background:#fff;border:1px solid #e6e8ec;border-radius:12px;padding:28px 32px}}
input,button{{font:inherit;padding:8px 12px;border-radius:8px;border:1px solid #b9bec6}}button{{background:#1f5fbf;color:#fff;
border-color:#1f5fbf}}p{{color:#cf2a3c;margin:0 0 10px}}</style><form method="post" action="/token"><h3>Outrider</h3>{line}
<input type="password" name="token" placeholder="token" aria-label="token" autofocus> <button>Enter</button></form></html>"""


class Guard:
    """Stands before the whole application.

    Args:
        app: What it guards.
        token: What one must know; empty: nothing, but be on this machine.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app = app
        """What it guards."""
        self._token = token
        self._pass = hmac.new(token.encode(), b"outrider dashboard", hashlib.sha256).hexdigest()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let through, ask for the token, or refuse."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if self._is_stranger(headers):
            await _refuse(scope, receive, send, PlainTextResponse("not from there", status_code=403))
        elif not self._token or self._has_pass(headers, scope):
            await self.app(scope, receive, send)
        else:
            await _refuse(scope, receive, send, await self._ask(scope, receive))

    def _is_stranger(self, headers: MutableMapping[str, str]) -> bool:
        host, origin = headers.get("host", ""), headers.get("origin", "")
        if origin and urlsplit(origin).netloc != host:
            return True
        return not self._token and urlsplit(f"//{host}").hostname not in LOOPBACK

    def _cookie(self, scope: Scope) -> str:
        return f"outrider_{(scope.get('server') or ('', 0))[1]}"  # cookies do not know ports

    def _has_pass(self, headers: MutableMapping[str, str], scope: Scope) -> bool:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self._cookie(scope))
        except CookieError:
            return False
        return found is not None and hmac.compare_digest(found.value.encode(), self._pass.encode())

    async def _ask(self, scope: Scope, receive: Receive) -> Response:
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if scope["type"] == "http" and scope["method"] == "POST" and scope["path"] == "/token":
            given = parse_qs((await _body(receive)).decode("utf-8", "replace")).get("token", [""])[0]
        if not given:
            return HTMLResponse(_FORM.format(line=""), status_code=401)
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            await asyncio.sleep(_SLOWLY)
            return HTMLResponse(_FORM.format(line="<p>That is not the token.</p>"), status_code=401)
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(self._cookie(scope), self._pass, httponly=True, samesite="strict")
        return response


async def _refuse(scope: Scope, receive: Receive, send: Send, response: Response) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
        return
    await response(scope, receive, send)


async def _body(receive: Receive) -> bytes:
    body = b""
    while len(body) <= _LARGEST:
        message: MutableMapping[str, Any] = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body[:_LARGEST]
