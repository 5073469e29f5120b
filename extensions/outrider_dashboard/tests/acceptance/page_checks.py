"""Checks of the page with several pairs, at the end of a run, and behind proxies."""

import contextlib
import http.client
import http.server
import re
import socket
import socketserver
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from page_stage import Failed, Page, Processes, wait_until

from bus.registry import LAWS

_PAIRS = 3
_UNTITLED = """[...document.querySelectorAll(".tile, .chart, .link-row output, .process, .readout, input[type=number]")]
  .filter((one) => one.offsetParent && /\\d/.test(one.textContent + (one.value || "") + one.className))
  .filter((one) => !((one.closest("[title]") || {}).title)).map((one) => one.id || one.textContent)"""
_OVERLAPS = """outrider.ground.labels.boxes.flatMap((a, k, all) => all.slice(k + 1)
  .filter((b) => a.x < b.x + b.w && b.x < a.x + a.w && a.y < b.y + b.h && b.y < a.y + a.h)
  .map((b) => [a.name, b.name]))"""
_OVERFLOWING = """[...document.querySelectorAll(".card, .tile, .chip, .top, .row-of, .legend")]
  .filter((one) => one.offsetParent && one.scrollWidth > one.clientWidth + 1)
  .map((one) => one.className + one.innerText)"""
_CUT_CHIPS = """[...document.querySelectorAll(".chip")].map((one) => [one, one.getBoundingClientRect()])
  .filter(([one, box]) => box.right > innerWidth || box.left < 0 || !parseFloat(getComputedStyle(one).fontSize))
  .map(([one]) => one.innerText)"""
_ACTIVE = """["button", "input", "select", "[role=slider]", "[role=switch]"]
  .flatMap((kind) => [...document.querySelectorAll(`.side ${kind}`)])
  .filter((one) => one.offsetParent && !one.disabled && !one.closest("[inert], [disabled], .disabled"))
  .map((one) => one.innerText || one.ariaLabel || one.tagName)"""
_DISTORTED = """[...document.querySelectorAll("canvas")]
  .filter((one) => Math.abs(one.height / devicePixelRatio - one.clientHeight) > 1).map((one) => one.id)"""
_GOAL_IS_DRAWN = """(() => {
  const { canvas, view } = outrider.ground;
  const [x, y] = outrider.store.scene.vehicles.find(({ name }) => name === "ugv_2").goals[4];
  const ratio = canvas.width / canvas.clientWidth;
  const place = [view.X(x), view.Y(y)].map((at) => Math.round(at * ratio));
  const found = canvas.getContext("2d").getImageData(...place, 1, 1).data;
  const wanted = parseInt(outrider.store.colors.ugv[2].slice(1), 16);
  return Math.max(...[16, 8, 0].map((shift, k) => Math.abs(((wanted >> shift) & 255) - found[k]))) < 40;
})()"""


def _scenario() -> str:
    """Return the text of a scenario with three pairs, near one another."""
    lines = ['title = "Three pairs"', "duration = 200.0", '[law]\nname = "certified"']
    for k in range(_PAIRS):
        x, y = 7.0 + 6.0 * k, 8.0 + 4.0 * k
        lines += [
            f'[[uav]]\nname = "uav_{k}"\nescorts = "ugv_{k}"\nposition = [{x}, {y + 1.0}]',
            "max_speed = 0.6\nmax_acceleration = 0.3",
        ]
    for k in range(_PAIRS):
        x, y = 7.0 + 6.0 * k, 8.0 + 4.0 * k
        goals = [[14 + 4 * k, 8 + 3 * k], [20 - 3 * k, 13 + 4 * k], [15, 19], [22, 24], [36, 4 + k]]
        lines += [
            f'[[ugv]]\nname = "ugv_{k}"\nposition = [{x}, {y}]\nmax_speed = 0.2',
            f'max_acceleration = 0.1\ndriver = "waypoints"\ngoals = {goals}',
        ]
    return "\n".join(lines) + "\n"


def _none(page: Page, script: str, what: str) -> None:
    found = page.run(script)
    if found:
        raise Failed(f"{what}: {found}")


def check_pairs(browser: Any, processes: Processes, pictures: Path | None) -> str:
    """Check everything on a page with three pairs, light and dark, wide and narrow, to the end of the run."""
    run = processes.run(_scenario(), "--realtime", "3")
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light")
    page = Page(context, processes.address("pairs"), complaints)
    wait_until(lambda: page.tick > 100, "three pairs fly")
    if page.run("window.ran") or "<img" not in page.page.locator("#scenario").inner_text():
        raise Failed("the scenario's name is not shown as text")
    _check_layout(page, pictures, "pairs")
    _check_legends(page)
    _check_selection(page)
    _check_dark(page, pictures)
    _check_choices(page)
    _check_ranges(page)
    if complaints:
        raise Failed("; ".join(complaints[:5]))
    _check_end(page, run, pictures)
    context.close()
    return "names, legends, close-up, goals, tooltips, dark, ranges; nothing to touch at the end"


def _check_layout(page: Page, pictures: Path | None, name: str) -> None:
    """Check that no names overlap, nothing sticks out, and processes are named, wide and narrow."""
    for width, height in ((390, 844), (1280, 800)):
        page.page.set_viewport_size({"width": width, "height": height})
        time.sleep(1.0)
        for _ in range(20):
            _none(page, _OVERLAPS, f"names over one another at {width} px")
            time.sleep(0.1)
        if page.run("outrider.ground.labels.boxes.length") < _PAIRS:
            raise Failed(f"names are missing at {width} px")
        _none(page, _OVERFLOWING, f"sticks out at {width} px")
        _none(page, _CUT_CHIPS, f"no names of processes at {width} px")
        _none(page, _UNTITLED, "numbers without a tooltip")
        if pictures is not None:
            page.page.screenshot(path=pictures / f"{name}-{width}.png", full_page=True)


def _check_legends(page: Page) -> None:
    text = page.page.locator(".map-card .legend").inner_text()
    vehicles = page.run("Object.keys(outrider.store.truth.vehicles)")
    entries = [
        *vehicles,
        "visibility radius",
        "switching radius",
        "sensing range",
        "UAV to its UGV",
        "goal",
    ]
    lacking = [one for one in entries if one not in text]
    charts = page.page.locator(".charts .legend").inner_text()
    lacking += [name for name in vehicles if name.startswith("uav") and name not in charts]
    if lacking:
        raise Failed(f"not in a legend: {lacking}")
    wait_until(lambda: page.run(_GOAL_IS_DRAWN), "a goal is drawn in its UGV's colour", 3.0)


def _check_selection(page: Page) -> None:
    """Check that close-up and map follow the selected vehicle."""

    def point() -> bool:
        x, y = page.run(
            "(({ view }, { position: [x, y] }) => [view.X(x), view.Y(y)])"
            "(outrider.ground, outrider.store.truth.vehicles.uav_2)"
        )
        page.page.locator("#map").click(position={"x": x, "y": y})
        return bool(page.run("outrider.store.selected === 'uav_2'"))

    wait_until(point, "pointing at uav_2 selects it")
    shown = "outrider.ground.closeUp.shown"
    wait_until(lambda: page.run(shown) == "ugv_2", "the close-up shows its UGV")
    page.page.select_option("#map-vehicle", "ugv_1")
    wait_until(lambda: page.run(shown) == "ugv_1", "the close-up shows ugv_1")
    if page.run("document.getElementById('wheel-vehicle').value") != "ugv_1":
        raise Failed("teleoperation does not follow the selected vehicle")


def _check_dark(page: Page, pictures: Path | None) -> None:
    light = page.run("getComputedStyle(document.body).backgroundColor")
    page.page.emulate_media(color_scheme="dark")
    wait_until(
        lambda: page.run("getComputedStyle(document.body).backgroundColor") != light,
        "the page turns dark with its system",
    )
    if page.run("outrider.store.colors.paper") == "#ffffff":
        raise Failed("the pictures stay light")
    if pictures is not None:
        page.page.screenshot(path=pictures / "pairs-dark.png")
    page.page.locator("#theme").click()
    page.page.locator("#theme").click()
    wait_until(
        lambda: page.run("getComputedStyle(document.body).backgroundColor") == light,
        "the page is light where the user wants it so",
    )


def _check_choices(page: Page) -> None:
    page.page.get_by_role("combobox", name="law").click()
    option = page.page.get_by_role("option").filter(has_text=LAWS["switching"].about)
    wait_until(option.is_visible, "the list of laws tells what each does")
    page.page.keyboard.press("Escape")
    wait_until(lambda: not option.is_visible(), "the list closes")


def _check_ranges(page: Page) -> None:
    for label, wrong, right, act in (
        ("ticks", "0", "1", lambda: page.click("Step")),
        ("loss, number", "150", "0", lambda: page.page.keyboard.press("Tab")),
    ):
        page.page.get_by_label(label).fill(wrong)
        message = page.page.get_by_text(f"{wrong} is invalid; allowed")
        wait_until(message.is_visible, f"{label} = {wrong} is refused with a message")
        act()
        time.sleep(1.0)
        if page.status["paused"] or page.status["changes"]:
            raise Failed(f"{label} = {wrong} has been sent")
        page.page.get_by_label(label).fill(right)
        wait_until(lambda shown=message: not shown.is_visible(), "the message goes")


def _check_end(page: Page, run: "subprocess.Popen[bytes]", pictures: Path | None) -> None:
    if not page.run(_ACTIVE):
        raise Failed("nothing can be touched while it is flown")
    page.page.get_by_role("switch", name="lockstep").click()
    wait_until(lambda: page.status["over"], "the run ends", 90.0)
    wait_until(lambda: not page.run(_ACTIVE), "nothing can be touched at its end", 5.0)
    run.wait(60.0)
    time.sleep(1.5)
    _none(page, _ACTIVE, "active after the end")
    _none(page, _DISTORTED, "distorted at the end")
    if "over" not in page.banner():
        raise Failed(f"at the end the page says {page.banner()!r}")
    if pictures is not None:
        page.page.screenshot(path=pictures / "pairs-over.png")


@contextlib.contextmanager
def _plain_proxy(port: int) -> Iterator[int]:
    """Return the port of a proxy to this port that passes HTTP but no WebSockets."""

    class Proxy(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            if "upgrade" in self.headers.get("Connection", "").lower():
                self.send_error(400)
                return
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0)) or None
            upstream = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            headers = {k: v for k, v in self.headers.items() if k.lower() != "connection"}
            with contextlib.closing(upstream):
                upstream.request(self.command, self.path, body, headers)
                answer = upstream.getresponse()
                content = answer.read()
            self.send_response_only(answer.status)
            for name, value in answer.getheaders():
                if name.lower() not in ("transfer-encoding", "content-length", "connection"):
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            if self.command != "HEAD":
                with contextlib.suppress(BrokenPipeError):  # the page was closed
                    self.wfile.write(content)

        do_POST = do_HEAD = do_GET  # noqa: N815 - the library's names

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def check_proxy(context: Any, port: int) -> str:
    """Check that without a WebSocket the page says so, blames no other process, and offers no control."""
    with _plain_proxy(port) as proxied:
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{proxied}/")

        def until(script: str, what: str) -> Callable[[], Any]:
            return wait_until(lambda: page.evaluate(f"() => ({script})"), what)

        until("document.querySelector('.side .q-btn') && true", "the page is built")
        until("/WebSocket/.test(document.getElementById('banner').innerText)", "it says what lacks")
        active = page.evaluate(f"() => ({_ACTIVE})")
        blamed = page.locator(".chip.bad, .process.bad").count()
        line = page.locator("#banner").inner_text()
        page.close()
    if active:
        raise Failed(f"active without frames: {active}")
    if blamed or re.search("router|simulator", line):
        raise Failed(f"other processes are blamed: {line!r}")
    return line.partition(":")[0]


_PATH = "/lab"


class _Relay(socketserver.BaseRequestHandler):
    """Connection of a proxy that serves the page under a path, like nginx with `proxy_pass http://127.0.0.1:8080/;`."""

    upstream = 0
    """Port of the page."""

    def handle(self) -> None:
        """Change the head of one request, then pass everything on."""
        head = b""
        while b"\r\n\r\n" not in head:
            part = self.request.recv(1 << 16)
            if not part:
                return
            head += part
        first, *headers = head.split(b"\r\n")
        if not first.partition(b" ")[2].startswith(f"{_PATH}/".encode()):
            self.request.sendall(b"HTTP/1.1 404 Not Found\r\nConnection: close\r\n\r\n")
            return
        first = first.replace(_PATH.encode(), b"", 1)
        added = [b"X-Forwarded-Prefix: " + _PATH.encode(), b"X-Forwarded-Proto: http"]
        if b"upgrade: websocket" not in head.lower():
            headers = [one for one in headers if not one.lower().startswith(b"connection:")]
            added.append(b"Connection: close")
        with socket.create_connection(("127.0.0.1", self.upstream)) as upstream:
            upstream.sendall(b"\r\n".join([first, *added, *headers]))
            sending = threading.Thread(target=_pass_on, args=(self.request, upstream), daemon=True)
            sending.start()
            _pass_on(upstream, self.request)
        with contextlib.suppress(OSError):
            self.request.shutdown(socket.SHUT_RDWR)
        sending.join()


def _pass_on(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while part := source.recv(1 << 16):
            target.sendall(part)


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True


def check_sub_path(browser: Any, port: int, token: str) -> str:
    """Check that a proxy can serve the page under a path of its own, with WebSockets and controls."""
    relay = type("Relay", (_Relay,), {"upstream": port})
    with _Server(("127.0.0.1", 0), relay) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        context = browser.new_context()
        page, paths, faults = context.new_page(), [], []
        page.on("request", lambda one: paths.append(one.url))
        page.on("response", lambda one: faults.append(one.url) if one.status >= 400 else None)
        page.on("pageerror", lambda one: faults.append(str(one)))
        here = f"http://127.0.0.1:{server.server_address[1]}{_PATH}/"
        page.goto(f"{here}?token={token}")
        for script, what in (
            ("document.querySelector('.side .q-btn') && true", "the page is built under a path"),
            ("window.outrider && outrider.stats.frames > 5", "frames arrive under a path"),
        ):
            wait_until(lambda script=script: page.evaluate(f"() => ({script})"), what)
        if page.url != here:
            raise Failed(f"the page is at {page.url}")
        page.close()
        context.close()
        server.shutdown()
    if faults:
        raise Failed(f"faults under a path: {faults[:3]}")
    if outside := [one for one in paths if not one.startswith((here, "data:", "blob:"))]:
        raise Failed(f"requests outside the path: {outside[:3]}")
    return f"{len(paths)} requests, all under {_PATH}"
