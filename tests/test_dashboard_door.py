"""The dashboard's access control, its headers and their cost: all in this process."""

import asyncio
import re
import uuid
from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from clocks import Clock
from nicegui import Client
from starlette.responses import PlainTextResponse
from starlette.testclient import TestClient
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

from bus.errors import ScenarioError
from outrider.view.page.access import attempts
from outrider.view.page.access.admission import Admission, choose_admission
from outrider.view.page.access.attempts import Attempts, Judgement
from outrider.view.page.access.headers import SecureHeaders
from outrider.view.page.access.login import Guard
from outrider.view.page.access.visitors import Visitors
from outrider.view.page.app import application
from outrider.view.page.hub import Hub
from outrider.view.page.sources.protocol import SourceState

TOKEN = "the-token-of-this-test"  # noqa: S105 - of this test alone
TICKET = "the-ticket-of-this-test"
HERE = "http://127.0.0.1:8080"
FIXED = {
    "x-frame-options": "DENY",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


class Built:
    """Stands in for the application, and counts what reaches it."""

    def __init__(self) -> None:
        self.count = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.count += 1
        await PlainTextResponse("the page")(scope, receive, send)


def guarded(admission: Admission) -> tuple[Built, TestClient]:
    built = Built()
    app = SecureHeaders(Guard(built, admission))
    return built, TestClient(
        app, base_url=HERE, follow_redirects=False, client=("127.0.0.1", 50000)
    )


@pytest.mark.parametrize("site", ["cross-site", "same-site", "nonsense"])
@pytest.mark.parametrize(
    "admission", [Admission(), Admission(token=TOKEN, ticket=TICKET)], ids=["open", "token"]
)
def test_what_another_site_asks_for_is_refused_before_anything_is_built(admission, site) -> None:
    built, browser = guarded(admission)
    for path in ("/", f"/?ticket={TICKET}", "/static/main.js", "/_nicegui_ws/socket.io/"):
        assert browser.get(path, headers={"Sec-Fetch-Site": site}).status_code == 403
    assert built.count == 0
    assert browser.get(f"/?ticket={TICKET}").status_code == 303  # it has not been used up


def test_the_browsers_user_and_the_page_itself_get_through() -> None:
    built, browser = guarded(Admission())
    for site in ("none", "same-origin"):
        assert browser.get("/", headers={"Sec-Fetch-Site": site, "Origin": HERE}).status_code == 200
    assert built.count == 2


NO_HOSTS = ("[", "[::1", "[::1]]:80", "127.0.0.1:port", "user@127.0.0.1", "", "a b")
NO_ORIGINS = ("http://[", "http://[::1", "127.0.0.1:8080", f"{HERE}/path", "file:///")


@pytest.mark.parametrize(
    ("host", "origins"),
    [
        *((host, ()) for host in NO_HOSTS),
        *(("127.0.0.1:8080", (origin,)) for origin in NO_ORIGINS),
        ("127.0.0.1:8080", (HERE, "http://elsewhere.example")),
    ],
)
def test_a_malformed_host_or_origin_is_refused(host: str, origins: tuple[str, ...]) -> None:
    headers = [("Host", host), *(("Origin", origin) for origin in origins)]
    built, browser = guarded(Admission())
    assert browser.get("/", headers=headers).status_code == 400
    with (
        pytest.raises(WebSocketDisconnect),
        browser.websocket_connect("/frames", headers=dict(headers)),
    ):
        pass
    assert built.count == 0


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("127.0.0.1:8080", "null", 403),
        ("127.0.0.1:8080", "http://127.0.0.1:9090", 403),
        ("127.0.0.1:8080", "http://elsewhere.example", 403),
        ("rebound.example:8080", "http://rebound.example:8080", 403),
        ("[::1]:8080", "http://[::1]:8080", 200),
        ("LOCALHOST:8080", "http://localhost:8080", 200),
    ],
)
def test_without_a_token_only_pages_of_this_machine_are_served(host, origin, status) -> None:
    _, browser = guarded(Admission())
    assert browser.get("/", headers={"Host": host, "Origin": origin}).status_code == status


def test_a_ticket_lets_in_one_browser_and_leaves_an_address_that_lets_in_no_other() -> None:
    built, first = guarded(Admission(token=TOKEN, ticket=TICKET))
    second = TestClient(first.app, base_url=HERE, follow_redirects=False)
    assert first.get("/").status_code == 401
    answer = first.get(f"/?ticket={TICKET}")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert TOKEN not in cookie
    assert first.get("/").status_code == 200
    # whoever is in loses it from the bar too
    assert first.get(f"/?ticket={TICKET}").headers["location"] == "/"
    assert second.get(f"/?ticket={TICKET}").status_code == 401
    assert second.get(f"/?token={TOKEN}").status_code == 401  # a token is no part of an address
    assert second.post("/token", data={"token": TOKEN}).status_code == 303
    assert second.get("/").status_code == 200
    assert built.count == 2


def test_another_start_knows_no_cookie_of_an_earlier_one() -> None:
    cookies = [
        guarded(Admission(token=TOKEN))[1]
        .post("/token", data={"token": TOKEN})
        .headers["set-cookie"]
        for _ in range(2)
    ]
    assert cookies[0] != cookies[1]


def test_every_answer_tells_the_browser_what_it_may_do() -> None:
    _, browser = guarded(Admission(token=TOKEN))
    # a browser sends the form with its origin for this alone: under no-referrer it says null, which is refused
    assert '<meta name="referrer" content="same-origin">' in browser.get("/").text
    answers = [browser.get("/"), browser.get("/", headers={"Host": "["}), browser.get("/nowhere")]
    answers += [
        browser.get("/", headers={"Sec-Fetch-Site": "cross-site"}),
        browser.post("/token", data={"token": "wrong"}),
    ]
    answers += [browser.post("/token", data={"token": TOKEN}), browser.get("/")]
    assert [answer.status_code for answer in answers] == [401, 400, 404, 403, 401, 303, 200]
    for answer in answers:
        assert FIXED.items() <= dict(answer.headers).items()
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def judge(clock: Clock) -> Attempts:
    return Attempts(TOKEN, clock=clock, sleep=clock.sleep)


def judged(judge: Attempts, tries: Iterable[tuple[str, str]]) -> list[Judgement]:
    """Tries to get in, an address and a token each, one after the other."""

    async def make() -> list[Judgement]:
        return [(await judge.judge(*one))[0] for one in tries]

    return asyncio.run(make())


def test_each_wrong_token_makes_the_next_wait_longer_and_the_right_one_waits_too(clock, judge):
    tokens = [*["wrong"] * 7, TOKEN, "wrong"]
    verdicts = judged(judge, [("10.0.0.1", token) for token in tokens])
    assert verdicts == [*[Judgement.WRONG] * 7, Judgement.RIGHT, Judgement.WRONG]
    assert clock.waits == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_tries_of_one_address_are_made_one_after_the_other_and_few_may_wait(clock, judge) -> None:
    async def crowd() -> list[Judgement]:
        await judge.judge("10.0.0.1", "wrong")
        tries = [judge.judge("10.0.0.1", TOKEN if k == 90 else "wrong") for k in range(100)]
        return [verdict for verdict, _ in await asyncio.gather(*tries)]

    verdicts = asyncio.run(crowd())
    assert verdicts.count(Judgement.WRONG) == 4
    assert verdicts.count(Judgement.BUSY) == 96  # the right one among them
    assert clock.most == 1


def test_another_address_waits_for_nobody_but_one_ipv6_network_is_one_address(clock, judge):
    for addresses, waits in (
        (("10.0.0.1", "10.0.0.2", "2001:db8::1"), []),
        (("2001:db8::2:3", "10.0.0.1", "::ffff:10.0.0.1"), [0.5, 1.0]),
    ):
        verdicts = judged(judge, [(address, "wrong") for address in addresses])
        assert verdicts == [Judgement.WRONG] * 3
        assert clock.waits == waits


def test_what_is_remembered_of_addresses_is_bounded(judge: Attempts) -> None:
    judged(judge, [(f"10.0.{k // 250}.{k % 250}", "wrong") for k in range(2000)])
    assert len(judge._addresses) == attempts._ADDRESSES


def test_a_browser_that_tries_tokens_too_fast_is_told_when_to_come_again(monkeypatch) -> None:
    monkeypatch.setattr(attempts, "_WAITING", 0)
    _, browser = guarded(Admission(token=TOKEN))
    answer = browser.post("/token", data={"token": TOKEN})
    assert answer.status_code == 429
    assert int(answer.headers["retry-after"]) >= 1


def test_a_page_has_a_token_unless_it_is_told_otherwise_and_none_only_where_no_machine_comes():
    first, second = choose_admission("127.0.0.1", ""), choose_admission("127.0.0.1", "")
    assert len({first.token, first.ticket, second.token, second.ticket}) == 4
    assert min(len(first.token), len(first.ticket)) >= 22  # 128 bits
    assert choose_admission("0.0.0.0", TOKEN) == Admission(token=TOKEN)  # noqa: S104 - which is not served
    assert choose_admission("localhost", "", wanted=False) == Admission()
    for host, token in (("0.0.0.0", ""), ("127.0.0.1", TOKEN)):  # noqa: S104 - which is refused
        with pytest.raises(ScenarioError, match="--no-token"):
            choose_admission(host, token, wanted=False)
    with pytest.raises(ScenarioError, match="--token"):
        choose_admission("127.0.0.1", "short")


# The page itself, as NiceGUI builds it


class Silence:
    """A source that has nothing to tell."""

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


@pytest.fixture(scope="module")
def page() -> Iterator[TestClient]:
    app: ASGIApp = application(
        Hub(Silence()), Admission(token=TOKEN), controls=None, ready=lambda: None
    )
    with TestClient(app, base_url=HERE) as browser:
        assert browser.post("/token", data={"token": TOKEN}).status_code == 200
        yield browser


def test_each_page_has_a_nonce_of_its_own_on_all_its_scripts_and_styles(page: TestClient) -> None:
    nonces = set()
    for _ in range(2):
        answer = page.get("/")
        policy = answer.headers["content-security-policy"]
        nonce = re.search(r"'nonce-([\w-]+)'", policy)
        assert nonce
        nonces.add(nonce[1])
        assert "unsafe-inline" not in policy
        assert "frame-ancestors 'none'" in policy
        tags = re.findall(r"<(?:script|style)[\s>][^>]*", answer.text)
        assert len(tags) >= 5
        assert all(f'nonce="{nonce[1]}"' in tag for tag in tags)
        assert FIXED.items() <= dict(answer.headers).items()
    assert len(nonces) == 2


def test_pages_that_nobody_opens_are_few(page: TestClient) -> None:
    for _ in range(150):
        assert page.get("/").status_code == 200
    assert len(Client.instances) <= 16
    built = len(Client.instances)
    assert page.get("/nowhere").status_code == 404
    assert page.head("/").status_code == 405
    assert len(Client.instances) == built


def test_a_page_that_is_opened_is_not_taken_for_one_that_nobody_opens(monkeypatch) -> None:
    visitors, handlers = Visitors(), SimpleNamespace()
    deleted: list[str] = []

    class Page:
        def __init__(self) -> None:
            self.id, self.created = str(uuid.uuid4()), 0.0

        def on_connect(self, handler: Any) -> None:
            handlers.connect = handler

        def on_delete(self, handler: Any) -> None:
            handlers.delete = handler

        def delete(self) -> None:
            deleted.append(self.id)
            handlers.delete(self)

    opened, left = Page(), Page()
    for built in (opened, left):
        monkeypatch.setattr(
            "outrider.view.page.access.visitors.ui",
            SimpleNamespace(context=SimpleNamespace(client=built)),
        )
        visitors.welcome()
        if built is opened:
            handlers.connect(built)
    visitors.tidy(10.0)
    assert deleted == []
    visitors.tidy(30.0)
    assert deleted == [left.id]
    assert visitors.unopened == 0
