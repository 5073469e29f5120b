"""Access to the page: the token, other sites, headers, and bounds on what a client without the token can occupy."""

import contextlib
import http.client
import re
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from bus.errors import ScenarioError
from outrider_dashboard.address import (
    Access,
    address_among,
    address_of,
    choose_token,
    open_socket,
    trusted_proxies,
)
from outrider_dashboard.app import application
from outrider_dashboard.hub import Hub
from outrider_dashboard.page_guard import MAX_PENDING, Guard
from outrider_dashboard.sources.protocol import SourceState
from processes import free_port, wait_until

TOKEN = "the-token-of-this-test"  # noqa: S105 - used in this test only
HERE = "http://127.0.0.1:8080"
FIXED = {
    "x-frame-options": "DENY",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


def guarded(token: str, client: str = "127.0.0.1") -> TestClient:
    app = Guard(PlainTextResponse("the page"), Access(token))
    return TestClient(app, base_url=HERE, follow_redirects=False, client=(client, 50000))


def opened(token: str) -> TestClient:
    """Return a client that has opened the page with the token."""
    browser = guarded(token)
    if token:
        assert browser.get(f"/?token={token}").status_code == 303
    assert browser.get("/").status_code == 200
    return browser


@pytest.mark.parametrize("token", ["", TOKEN], ids=["open", "token"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:9090"},
        {"Origin": "http://elsewhere.example"},
        {"Origin": "http://["},
        {"Host": "[", "Origin": HERE},
    ],
    ids=str,
)
def test_requests_of_other_sites_are_refused(token: str, headers: dict[str, str]) -> None:
    browser = opened(token)
    for path in ("/", f"/?token={token}", "/static/main.js", "/_nicegui_ws/socket.io/"):
        assert browser.get(path, headers=headers).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect),
        browser.websocket_connect("/frames", headers=headers),
    ):
        pass


@pytest.mark.parametrize("token", ["", TOKEN], ids=["open", "token"])
def test_the_user_and_the_page_itself_get_through(token: str) -> None:
    browser = opened(token)
    for site in ("none", "same-origin"):
        answer = browser.get("/", headers={"Sec-Fetch-Site": site, "Origin": HERE})
        assert answer.status_code == 200


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("rebound.example:8080", 403),
        ("127.0.0.1.example", 403),
        ("[::1]:8080", 200),
        ("LOCALHOST:8080", 200),
    ],
)
def test_without_a_token_only_this_machines_hosts_are_served(host: str, status: int) -> None:
    assert guarded("").get("/", headers={"Host": host}).status_code == status


def test_the_token_opens_the_page_and_leaves_the_address() -> None:
    browser = guarded(TOKEN)
    for path in ("/", "/?token=", "/?token=wrong", "/?token=%ff", "/?token=ä", "/static/main.js"):
        assert browser.get(path).status_code == 401
        with pytest.raises(WebSocketDisconnect), browser.websocket_connect(path):
            pass
    answer = browser.get(f"/?token={TOKEN}")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert TOKEN not in cookie
    assert browser.get("/").status_code == 200


@pytest.mark.parametrize(
    "others",
    ["", 'a="\\a"; ', "a; =; b=c=d;", "outrider_8080=other; "],
    ids=["alone", "quoted", "malformed", "of another path"],
)
def test_our_cookie_is_found_among_others(others: str) -> None:
    browser = guarded(TOKEN)
    own = browser.get(f"/?a&token=&token={TOKEN}&b").headers["set-cookie"].partition(";")[0]
    browser.cookies.clear()
    for cookies in (f"{others}{own}", f"{own}; {others}"):
        assert browser.get("/", headers={"Cookie": cookies}).status_code == 200
    for wrong in (f"x{own}", f"{own}x", f'a="{own}"', others):
        assert browser.get("/", headers={"Cookie": wrong}).status_code == 401


BEHIND = {"X-Forwarded-Prefix": "/lab/outrider/", "X-Forwarded-Proto": "https"}


@pytest.mark.parametrize(
    ("client", "headers", "location", "secure"),
    [
        ("127.0.0.1", BEHIND, "/lab/outrider/", True),
        ("127.0.0.1", {"X-Forwarded-Prefix": "/lab"}, "/lab/", False),
        ("127.0.0.1", {"X-Forwarded-Proto": "https, http"}, "/", True),
        ("127.0.0.1", {"X-Forwarded-Prefix": "//elsewhere.example"}, "/", False),
        ("127.0.0.1", {"X-Forwarded-Prefix": '/"><script>'}, "/", False),
        ("192.0.2.7", BEHIND, "/", False),
    ],
)
def test_only_a_trusted_proxy_sets_path_and_tls(
    client: str, headers: dict[str, str], location: str, *, secure: bool
) -> None:
    answer = guarded(TOKEN, client).get(f"/?token={TOKEN}", headers=headers)
    assert answer.headers["location"] == location
    cookie = answer.headers["set-cookie"].split("; ")
    assert ("Secure" in cookie) is secure
    assert f"Path={location.rstrip('/') or '/'}" in cookie


def test_proxies_are_local_ones_and_those_named() -> None:
    trusted = trusted_proxies("192.0.2.7, 172.16.0.0/12")
    for host in ("127.0.0.1", "::1", "::ffff:192.0.2.7", "192.0.2.7", "172.18.0.1"):
        assert address_among(host, trusted)
    for host in ("192.0.2.8", "2001:db8::1", "localhost", ""):
        assert not address_among(host, trusted)
    with pytest.raises(ScenarioError, match=r"--proxy proxy\.example"):
        trusted_proxies("proxy.example")


def test_a_cookie_ends_with_its_server() -> None:
    cookie = guarded(TOKEN).get(f"/?token={TOKEN}").headers["set-cookie"].partition(";")[0]
    assert guarded(TOKEN).get("/", headers={"Cookie": cookie}).status_code == 401


def test_every_response_has_the_security_headers() -> None:
    browser = guarded(TOKEN)
    answers = [
        browser.get("/"),
        browser.get("/", headers={"Sec-Fetch-Site": "cross-site"}),
        browser.get(f"/?token={TOKEN}"),
        browser.get("/"),
    ]
    assert [answer.status_code for answer in answers] == [401, 403, 303, 200]
    for answer in answers:
        assert FIXED.items() <= dict(answer.headers).items()
        policy = answer.headers["content-security-policy"]
        assert {"default-src 'none'", "script-src-attr 'none'", "frame-ancestors 'none'"} <= set(
            policy.split("; ")
        )


def test_a_token_is_random_unless_chosen() -> None:
    first, second = choose_token("127.0.0.1", ""), choose_token("127.0.0.1", "")
    assert first != second
    assert min(len(first), len(second)) >= 22  # 128 bits
    assert choose_token("0.0.0.0", TOKEN) == TOKEN  # noqa: S104 - not served
    assert choose_token("localhost", "", wanted=False) == ""
    with open_socket("127.0.0.1", 0) as listening:
        here = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        assert address_of(listening, TOKEN) == f"{here}?token={TOKEN}"
        assert address_of(listening, "") == here


@pytest.mark.parametrize("token", ["short", "x" * 19, "x" * 129, "twenty letters & more"])
def test_a_token_that_can_be_guessed_is_refused(token: str) -> None:
    with pytest.raises(ScenarioError, match="20 to 128"):
        choose_token("127.0.0.1", token)


@pytest.mark.parametrize(("host", "token"), [("0.0.0.0", ""), ("127.0.0.1", TOKEN)])  # noqa: S104
def test_disabled_token_is_refused_where_it_cannot_protect(host: str, token: str) -> None:
    with pytest.raises(ScenarioError, match="--no-token"):
        choose_token(host, token, wanted=False)


# The page itself, as NiceGUI builds it


class Silence:
    """A source of no messages."""

    may_steer = False
    factor = 0.0
    standing = SourceState()

    def news(self) -> Iterator[Any]:
        return iter(())

    def control(self, _control: object) -> bool:
        return False

    def drive(self, _vehicle: str, _drive: object) -> bool:
        return False

    def close(self) -> None:
        pass


def test_the_page_and_its_files_are_served() -> None:
    app = application(Hub(Silence()), Access(TOKEN), controls=None, ready=lambda: None)
    with TestClient(app, base_url=HERE, client=("127.0.0.1", 50000)) as browser:
        page = browser.get(f"/?token={TOKEN}")
        assert page.status_code == 200
        for file in ("/static/colors.css", "/static/dashboard.css", "/static/main.js"):
            assert f'"{file}"' in page.text
            assert browser.get(file).status_code == 200
        assert FIXED.items() <= dict(page.headers).items()
        # Behind a proxy under a path of its own, which it removes from each request.
        page = browser.get("/", headers={"X-Forwarded-Prefix": "/lab"})
        links = re.findall(r'(?:src|href)="(/[^"]*)"|url\("(/[^"]*)"\)', page.text)
        assert len(links) > 5
        assert all(any(one.startswith("/lab/") for one in link) for link in links)
        assert f"{browser.get('/').text.count('/lab')}" == "0"


# A real server with at most 1,024 open files, and clients without the token

SERVER = """
import resource, socket, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
from starlette.responses import PlainTextResponse
from outrider_dashboard import page_guard
from outrider_dashboard.address import Access, open_socket
from outrider_dashboard.app import web_server
page_guard.HEAD_TIMEOUT = float(sys.argv[2])

async def app(scope, receive, send):
    if scope["type"] == "lifespan":
        await receive()
        await send({"type": "lifespan.startup.complete"})
        await receive()
        await send({"type": "lifespan.shutdown.complete"})
    else:
        await PlainTextResponse("the page")(scope, receive, send)

listening = open_socket("127.0.0.1", int(sys.argv[1]))
web_server(page_guard.Guard(app, Access("the-token-of-this-test"))).run(sockets=[listening])
"""


class Served:
    """The server, and clients of its port."""

    def __init__(self, process: "subprocess.Popen[bytes]", port: int) -> None:
        self.process, self.port = process, port

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=10.0)

    def status(self, path: str = "/") -> int:
        """Return the status of a request that must be answered within a second."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=1.0)
        with contextlib.closing(connection):
            connection.request("GET", path)
            return connection.getresponse().status

    def peak(self) -> float:
        """Return the peak memory of the process [MB]."""
        lines = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


@contextlib.contextmanager
def served(head_timeout: float = 60.0) -> Iterator[Served]:
    port = free_port()
    command = [sys.executable, "-c", SERVER, str(port), str(head_timeout)]
    with subprocess.Popen(command) as process:
        server = Served(process, port)
        try:
            wait_until(lambda: _listens(port))
            yield server
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def server() -> Iterator[Served]:
    with served() as one:
        yield one


@pytest.fixture(scope="module")
def hasty_server() -> Iterator[Served]:
    """A server that waits half a second for the head of a request."""
    with served(head_timeout=0.5) as one:
        yield one


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def ended(connection: socket.socket, seconds: float) -> bytes:
    """Return everything the server sends before it ends the connection, within this time."""
    received = b""
    connection.settimeout(seconds)
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        while part := connection.recv(1 << 16):
            received += part
    return received


@pytest.mark.parametrize(
    "header",
    [b"Cookie: " + b'a="\\"' * 40_000 + b"\r\n", b"a: b\r\n" * 3_000_000],
    ids=["cookie of 160 kB", "3 million headers"],
)
def test_large_head_costs_no_time_or_memory(server: Served, header: bytes) -> None:
    with server.connect() as attack:
        assert server.status(f"/?token={TOKEN}") == 303
        before = server.peak()
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):
            attack.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + header + b"\r\n")
        assert server.status() == 401
        assert b" 200 " not in ended(attack, 1.0)
        assert server.peak() - before < 10.0


@pytest.mark.parametrize(
    "head",
    [b'/ HTTP/1.1\r\nCookie: a="' + rb"\a" * 8_000 + b'"', b"/?" + b"a=&" * 5_000 + b" HTTP/1.1"],
    ids=["cookie", "query"],
)
def test_thirty_hostile_heads_do_not_delay_a_user(server: Served, head: bytes) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(30):
            attack = stack.enter_context(server.connect())
            attack.sendall(b"GET " + head + b"\r\nHost: 127.0.0.1\r\n\r\n")
        assert server.status(f"/?token={TOKEN}") == 303


def test_idle_connections_keep_no_new_user_out(server: Served) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    try:
        with contextlib.ExitStack() as stack:
            for _ in range(1200):
                stack.enter_context(server.connect())
            assert server.status() == 401
            assert server.status(f"/?token={TOKEN}") == 303
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


UPGRADE = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
"""Headers of a request for a WebSocket, which uvicorn parses before the guard."""


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nA: ",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n" + UPGRADE + b"A: " + b"b" * 9_000 + b"\r\n\r\n",
    ],
    ids=["nothing", "a part", "a WebSocket's long line"],
)
def test_a_head_that_does_not_come_ends_its_connection(hasty_server: Served, sent: bytes) -> None:
    with hasty_server.connect() as slow:
        slow.sendall(sent)
        assert ended(slow, 5.0) == b""


def test_a_refused_request_ends_its_connection(server: Served) -> None:
    with server.connect() as slow:
        slow.sendall(b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100000\r\n\r\na")
        assert ended(slow, 5.0).startswith(b"HTTP/1.1 401 ")


def test_a_slow_head_within_the_bounds_is_served(server: Served) -> None:
    with server.connect() as slow:
        for byte in f"GET /?token={TOKEN} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode():
            slow.sendall(bytes([byte]))
            time.sleep(0.002)
        assert slow.recv(1 << 16).startswith(b"HTTP/1.1 303 ")


def test_only_the_oldest_idle_connection_makes_room(server: Served) -> None:
    with contextlib.ExitStack() as stack:
        idle = [stack.enter_context(server.connect()) for _ in range(MAX_PENDING)]
        assert server.status() == 401
        assert ended(idle[0], 5.0) == b""
        idle[-1].sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert idle[-1].recv(1 << 16).startswith(b"HTTP/1.1 401 ")
