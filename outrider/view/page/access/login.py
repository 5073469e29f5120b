"""Lets browsers in that know the token or have the ticket, or this machine's own where there is none.

A request is judged by its headers before anything is built for it. Pages of other sites get nothing, whatever the
browser sends along with their requests: otherwise any page in the same browser could take the wheel.
"""

import hmac
import re
import secrets
from collections.abc import Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from bus.locator import LOOPBACK
from outrider.view.page.access.admission import Admission
from outrider.view.page.access.attempts import Attempts, Judgement

_LARGEST = 4096
"""Of a form [bytes]."""
_AUTHORITY = r"(?P<host>\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(:[0-9]{1,5})?"
_HOST = re.compile(_AUTHORITY)
_ORIGIN = re.compile(rf"https?://(?P<authority>{_AUTHORITY})")
_OPAQUE = "null"
"""Origin of a page that has none: a file, or a frame without rights."""
_TRUSTED_SITES = ("same-origin", "none")
"""The values of `Sec-Fetch-Site` that are let in: the page itself asks, or the browser's user.

Clients that are no browsers do not say it.
"""
_ONCE = ("host", "origin", "sec-fetch-site", "cookie")
_SERVED = re.compile(r"/(token|favicon\.ico|frames|(static|_nicegui|_nicegui_ws)/.*)?")
"""Paths that lead anywhere: for others NiceGUI would build a page that says so."""

FORM_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;background:#f4f5f7;color:#22262d;display:grid;place-items:center;"
    "min-height:90vh}form{background:#fff;border:1px solid #e6e8ec;border-radius:12px;padding:28px 32px}"
    "input,button{font:inherit;padding:8px 12px;border-radius:8px;border:1px solid #b9bec6}"
    "button{background:#1f5fbf;color:#fff;border-color:#1f5fbf}p{color:#cf2a3c;margin:0 0 10px}"
)
"""Of the page that asks for the token; the policy of content names it by its hash."""
_FORM = f"""<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta name="referrer" content="same-origin"><title>Outrider</title>
<style>{FORM_STYLE}</style><form method="post" action="/token"><h3>Outrider</h3>%s
<input type="password" name="token" placeholder="token" aria-label="token"
autocomplete="off" autofocus> <button>Enter</button></form></html>"""
"""Its own policy of referrers.

Under the one of all responses, which is none, a browser sends a form as from nowhere.
"""
_NOT_FROM_THERE = "Not from another site: open the page by its address."


class Guard:
    """Stands before the whole application.

    Args:
        app: What it guards.
        admission: What one must know.
    """

    def __init__(self, app: ASGIApp, admission: Admission) -> None:
        self.app = app
        """The application that it guards."""
        self._attempts = Attempts(admission.token) if admission.token else None
        self._ticket = admission.ticket
        # Not made from the token: else a guess could be tried as a cookie, as fast as one likes.
        self._pass = secrets.token_urlsafe(32)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let through, ask for the token, or refuse."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        answer = await self._answer(scope, receive)
        if answer is None:
            await self.app(scope, receive, send)
            return
        answer.headers["Cache-Control"] = "no-store"
        if scope["type"] == "websocket":
            await receive()  # that it wants to connect
        await answer(scope, receive, send)

    async def _answer(self, scope: Scope, receive: Receive) -> Response | None:
        """The answer in the application's place; None: let through."""
        headers = _headers_of(scope)
        host = _HOST.fullmatch((headers or {}).get("host", ""))
        origin = "" if headers is None else headers.get("origin", "")
        said = _ORIGIN.fullmatch(origin)
        if headers is None or host is None or not (said or origin in ("", _OPAQUE)):
            return PlainTextResponse("malformed Host or Origin", status_code=400)
        if self._is_stranger(host, origin, said, headers.get("sec-fetch-site")):
            return PlainTextResponse(_NOT_FROM_THERE, status_code=403)
        if not _SERVED.fullmatch(scope["path"]):
            return PlainTextResponse("nothing is there", status_code=404)
        return await self._admit(scope, receive, headers)

    def _is_stranger(
        self, host: re.Match[str], origin: str, said: re.Match[str] | None, site: str | None
    ) -> bool:
        if site is not None and site not in _TRUSTED_SITES:
            return True
        if origin and (said is None or said["authority"].lower() != host[0].lower()):
            return True
        return self._attempts is None and host["host"].strip("[]").lower() not in LOOPBACK

    async def _admit(
        self, scope: Scope, receive: Receive, headers: dict[str, str]
    ) -> Response | None:
        """Let through whoever has the pass, or give it to whoever knows token or ticket."""
        ticket = _ticket_in(scope)
        asked = scope["type"] == "http" and scope["path"] == "/token"
        if self._attempts is None or self._has_pass(headers, scope):
            return RedirectResponse("/", status_code=303) if ticket or asked else None
        if ticket:
            return (
                self._welcome(scope)
                if self._takes(ticket)
                else _form(401, "This address has been used: it opens once.")
            )
        form = await _body(receive) if asked and scope["method"] == "POST" else b""
        given = _field(form.decode("utf-8", "replace"), "token")
        if not given:
            return _form(401)
        verdict, wait = await self._attempts.judge((scope.get("client") or ("", 0))[0], given)
        if verdict is Judgement.RIGHT:
            return self._welcome(scope)
        if verdict is Judgement.WRONG:
            return _form(401, "That is not the token.")
        busy = _form(429, "Too many tokens from this address. Try again in a moment.")
        busy.headers["Retry-After"] = str(max(1, round(wait)))
        return busy

    def _takes(self, ticket: str) -> bool:
        """True if it is the one that has not been used yet. It is too long to be guessed, so that no try need wait."""
        if not self._ticket or not hmac.compare_digest(ticket.encode(), self._ticket.encode()):
            return False
        self._ticket = ""
        return True

    def _welcome(self, scope: Scope) -> Response:
        """To the page, by the address that stays in the browser's bar."""
        response = RedirectResponse("/", status_code=303)
        response.set_cookie(self._cookie(scope), self._pass, httponly=True, samesite="strict")
        return response

    def _cookie(self, scope: Scope) -> str:
        return f"outrider_{(scope.get('server') or ('', 0))[1]}"  # cookies do not know ports

    def _has_pass(self, headers: dict[str, str], scope: Scope) -> bool:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self._cookie(scope))
        except CookieError:
            return False
        return found is not None and hmac.compare_digest(found.value.encode(), self._pass.encode())


def _headers_of(scope: Scope) -> dict[str, str] | None:
    """Headers by name; None where one that is looked at is there twice."""
    rows: Iterable[tuple[bytes, bytes]] = scope["headers"]
    found: dict[str, str] = {}
    for raw, value in rows:
        name = raw.decode("latin-1").lower()
        if name in found and name in _ONCE:
            return None
        found[name] = value.decode("latin-1")
    return found


def _form(status: int, line: str = "") -> Response:
    return HTMLResponse(_FORM % (f"<p>{line}</p>" if line else ""), status_code=status)


def _ticket_in(scope: Scope) -> str:
    if scope["type"] != "http" or scope["path"] != "/":
        return ""
    return _field(scope.get("query_string", b"").decode("latin-1"), "ticket")


def _field(text: str, name: str) -> str:
    try:
        return parse_qs(text, max_num_fields=16).get(name, [""])[0]
    except ValueError:
        return ""


async def _body(receive: Receive) -> bytes:
    body = b""
    while len(body) <= _LARGEST:
        message: MutableMapping[str, Any] = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body[:_LARGEST]
