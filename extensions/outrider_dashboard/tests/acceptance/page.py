"""The dashboard in a real browser, with real processes.

Router, simulator, both vehicles, and Debian's Chromium without a screen.

    make page-test

Exit code 0: all checks pass; 1: a check fails, with its name; 77: a requirement is missing, in one line.
With --install it first tries to install Chromium from Debian's packages.
"""

import argparse
import contextlib
import http.client
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from page_budget import check_budget
from page_checks import check_pairs, check_proxy, check_sub_path
from page_stage import (
    OBSERVERS,
    OUTRIDER,
    RUN,
    Failed,
    Page,
    Processes,
    answers,
    free_port,
    say,
    wait_until,
)
from page_team import check_team

TOKEN = "a-token-for-the-test"  # noqa: S105 - used in this test only
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_PHONE = 664
"""Height that a phone 844 pixels high leaves to a page [px]."""
_INSTALLING = 300
"""Time limit of the package manager [s]."""
_OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
_COLOURS = """(() => {
  const map = document.getElementById("map");
  const pixels = new Uint32Array(map.getContext("2d").getImageData(0, 0, map.width, map.height).data.buffer);
  return new Set(pixels).size;
})()"""


def check_open_and_moving(first: Page) -> str:
    """Check numbers in the tiles, colours on the map, and the motion of both vehicles."""
    before = {name: first.position(name) for name in ("uav_0", "ugv_0")}
    wait_until(
        lambda: all(first.position(name) != before[name] for name in before), "both vehicles move"
    )
    for tile in ("time", "distance", "margin", "coverage_error", "realtime_factor"):
        text = first.page.locator(f"#tile-{tile} output").inner_text()
        if not text.replace(".", "").replace("-", "").isdigit():
            raise Failed(f"the tile {tile} shows {text!r}")
    painted = first.run(_COLOURS)
    if painted < 50:
        raise Failed(f"the map shows {painted} colours")
    return f"{painted} colours on the map"


def check_policy(context: Any, address: str) -> str:
    """Check that injected HTML and foreign scripts do not run, and that no other page can frame this one."""
    page = context.new_page()
    page.goto(address)
    page.evaluate("""() => {
      const image = document.createElement("div");
      image.innerHTML = "<img src='data:,' onerror='window.ran = true'>";
      const elsewhere = document.createElement("script");
      elsewhere.src = "data:text/javascript,window.ran = true";
      document.body.append(image, elsewhere);
    }""")
    time.sleep(0.5)
    if page.evaluate("() => window.ran"):
        raise Failed("a script runs that is none of the page's")
    page.close()
    outside = context.new_page()
    outside.set_content(f"<iframe src='{address}'></iframe>")
    outside.wait_for_timeout(1000)
    if any(frame.url.startswith(address) for frame in outside.frames):
        raise Failed("the page lets itself be framed")
    outside.close()
    return "only its own scripts run, and no other page frames it"


def check_frame_rate(first: Page) -> str:
    """Check the frame rate: at most 20 frames/s, fewer on a slow machine.

    The rate itself is reported, not judged.
    """
    count, began = first.run("outrider.stats.frames"), time.monotonic()
    time.sleep(5.0)
    rate = (first.run("outrider.stats.frames") - count) / (time.monotonic() - began)
    if not 2.0 <= rate <= 21.5:
        raise Failed(f"{rate:.1f} frames/s; 20 are wanted")
    return f"{rate:.1f} frames/s"


def check_reload(first: Page) -> str:
    """Check that charts and state are back after a reload."""
    rows = first.run("outrider.store.rows.length")
    first.page.reload()
    first.ready()
    wait_until(lambda: first.run("outrider.store.rows.length") >= rows, "the charts' past is back")
    tick = first.tick
    wait_until(lambda: first.tick > tick, "the reloaded page goes on")
    return f"{rows} rows are back"


def check_key(first: Page) -> str:
    """Check that keys drive the UGV and that it brakes when they are released."""
    first.page.keyboard.down("ArrowUp")
    wait_until(lambda: first.control() == "mine", "the first key takes control")
    wait_until(lambda: first.status["drivers"]["ugv_0"] == "teleop", "teleop drives")
    wait_until(lambda: first.velocity()[1] > 0.1, "a key drives the UGV north")
    first.page.keyboard.up("ArrowUp")
    wait_until(lambda: first.speed() < 0.01, "released, it brakes")
    first.page.keyboard.down("d")
    wait_until(lambda: first.velocity()[0] > 0.1, "the key D drives it east")
    first.page.keyboard.down("Space")
    wait_until(lambda: first.speed() < 0.01, "space brakes")
    first.page.keyboard.up("Space")
    first.page.keyboard.up("d")
    return "ArrowUp, D, space"


def check_pad(first: Page) -> str:
    """Check that a gamepad drives the UGV."""
    first.run(
        "window.pads = [{ id: 'stub pad', connected: true, axes: [-1, 0, 0, 0], buttons: [] }]"
    )
    wait_until(lambda: first.velocity()[0] < -0.1, "a gamepad drives the UGV west")
    wait_until(lambda: "stub pad" in first.page.locator("#pad").inner_text(), "the pad is named")
    first.run(
        "window.pads = [{ id: 'stub pad', connected: true, axes: [0.05, 0.05], buttons: [] }]"
    )
    wait_until(lambda: first.speed() < 0.01, "in the dead zone it brakes")
    first.run("window.pads = [null]")
    return "a stubbed pad"


def _box(page: Page, selector: str) -> dict[str, float]:
    """Return the edges of an element in the viewport [px]."""
    found: dict[str, float] = page.run(
        f"document.querySelector('{selector}').getBoundingClientRect().toJSON()"
    )
    return found


def _check_width(page: Page) -> None:
    """Check that the page fits its window and each tile its text."""
    if page.run("document.documentElement.scrollWidth > innerWidth"):
        raise Failed("the page is wider than its window")
    cut = page.run(
        "[...document.querySelectorAll('.tile')].filter((t) => t.scrollWidth > t.clientWidth).map((t) => t.innerText)"
    )
    if cut:
        raise Failed(f"cut off in their tiles: {cut}")


def check_tablet(context: Any, address: str, pictures: Path | None, complaints: list[str]) -> str:
    """Check that no half of the page is empty at 820 pixels."""
    page = Page(context, address, complaints)
    _check_width(page)
    ground, charts, side = (_box(page, what) for what in (".map-card", ".charts", ".side"))
    gap = max(charts["top"] - ground["bottom"], abs(charts["bottom"] - side["bottom"]))
    if gap > 24.0:
        raise Failed(f"{gap:.0f} pixels are empty below the map or the charts")
    if pictures is not None:
        page.page.screenshot(path=pictures / "tablet.png", full_page=True)
    page.page.close()
    return f"map over charts, as long as the controls beside them ({side['bottom']:.0f} pixels)"


def check_phone(page: Page) -> str:
    """Check that map and stick fit one screen of a phone, with the bars of a browser above and below."""
    _check_width(page)
    places = {what: _box(page, what) for what in ("#map", "#stick", "#take")}
    lowest = max(box["bottom"] for box in places.values())
    if min(box["top"] for box in places.values()) < 0.0 or lowest > _PHONE:
        raise Failed(f"map and stick do not fit {_PHONE} pixels: {places}")
    if page.page.locator(".map-card .legend").is_visible():
        raise Failed("the legend takes the room of the stick")
    page.page.locator("#map-legend").tap()
    wait_until(page.page.locator(".map-card .legend").is_visible, "a tap on ? explains the map")
    page.page.locator("#map-legend").tap()
    return f"both end {lowest:.0f} pixels from the top"


def check_zoom(page: Page, context: Any) -> str:
    """Check that buttons, pinch and drag change the map's section, and that it follows the UGV."""
    shown = "[outrider.ground.view.left, outrider.ground.view.bottom, outrider.ground.view.width]"
    page.page.locator("#map-follow").tap()
    for _ in range(3):
        page.page.locator("#map-closer").tap()
    wait_until(lambda: page.run(shown)[2] < 7.0, "three steps closer show less than 7 m")
    width = page.run(shown)[2]

    def in_the_middle() -> bool:
        x, y = page.position()
        left, bottom, wide = page.run(shown)
        return max(abs(x - left - wide / 2), abs(y - bottom - wide / 2)) < 0.5

    wait_until(in_the_middle, "the map follows the UGV")
    box = _box(page, "#map")
    x, y = (box["left"] + box["right"]) / 2, (box["top"] + box["bottom"]) / 2
    touch = context.new_cdp_session(page.page)

    def fingers(kind: str, *places: float) -> None:
        points = [{"x": at, "y": y, "id": k} for k, at in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", x - 80.0, x + 80.0)
    for apart in (70.0, 55.0, 40.0):
        fingers("touchMove", x - apart, x + apart)
    fingers("touchEnd")
    wait_until(lambda: page.run(shown)[2] > 1.5 * width, "two fingers show more")
    fingers("touchStart", x)
    for moved in (10.0, 30.0, 60.0):
        fingers("touchMove", x - moved)
    fingers("touchEnd")
    wait_until(lambda: not page.run("outrider.ground.follows"), "a drag ends the following")
    page.page.locator("#map-all").click()  # Chromium ignores a tap within milliseconds of a drag.
    wait_until(lambda: page.run(shown) == [0, 0, 40], "the whole ground is shown again")
    return f"{width:.1f} m around the UGV, two fingers, a drag, all"


def check_one_operator(first: Page, second: Page) -> str:
    """Check that one browser drives and the other cannot until the first has closed."""
    wait_until(
        lambda: second.control() == "other", "the other browser sees that another one drives"
    )
    if "drives ugv_0" not in second.page.locator("#who").inner_text():
        raise Failed("the other browser does not see who drives")
    second.run("outrider.take()")
    second.page.keyboard.down("ArrowUp")
    time.sleep(1.5)
    second.page.keyboard.up("ArrowUp")
    if second.control() != "other" or first.control() != "mine" or second.speed() > 0.01:
        raise Failed("a second browser has taken control")
    first.page.close()
    wait_until(lambda: second.control() == "free", "control is free once its browser has closed")
    return "one drives, the other sees who; a closed page frees control"


def check_touch(second: Page, context: Any) -> str:
    """Check the touch stick of a phone, and handing back."""
    second.page.get_by_role("button", name="Take control").tap()
    wait_until(lambda: second.control() == "mine", "a tap takes control")
    stick = second.page.locator("#stick")
    stick.scroll_into_view_if_needed()
    box = stick.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = context.new_cdp_session(second.page)

    def finger(kind: str, *places: float) -> None:
        points = [{"x": x, "y": at} for at in places]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    finger("touchStart", y)
    finger("touchMove", y + box["height"] / 2)
    wait_until(lambda: second.velocity()[1] < -0.1, "a finger on the stick drives the UGV south")
    finger("touchEnd")
    wait_until(lambda: second.speed() < 0.01, "lifted, it brakes")
    second.click("Return control")
    wait_until(
        lambda: second.status["drivers"]["ugv_0"] == "waypoints", "the previous driver continues"
    )
    wait_until(lambda: second.control() == "free" and second.speed() > 0.05, "and moves")
    return "a finger drives; handing back returns control to the previous driver"


def check_controls(page: Page) -> str:
    """Check all controls except teleoperation."""
    page.click("Pause")
    wait_until(lambda: page.status["paused"], "the run pauses")
    resume, step = (page.page.get_by_role("button", name=name) for name in ("Resume", "Step"))
    wait_until(resume.is_visible, "the button says that it resumes")
    if resume.bounding_box()["height"] > step.bounding_box()["height"]:
        raise Failed("Resume takes more than a line")
    tick = page.status["tick"]
    page.page.get_by_label("ticks").fill("5")
    page.page.get_by_label("ticks").blur()
    page.click("Step")
    wait_until(lambda: page.status["tick"] == tick + 5, "five ticks are stepped")
    time.sleep(0.5)
    if page.status["tick"] != tick + 5:
        raise Failed("a paused run goes on")
    page.choose("law", "switching")
    page.choose("driver", "wander")
    page.click("Resume")
    wait_until(lambda: page.status["law"] == "switching", "the law changes")
    wait_until(lambda: page.status["drivers"]["ugv_0"] == "wander", "the driver changes")
    page.page.get_by_role("switch", name="lockstep").click()
    wait_until(lambda: page.status.get("target_factor") is None, "lockstep")
    wait_until(lambda: page.status["realtime_factor"] > 2.0, "lockstep is faster than the clock")
    fast = page.status["realtime_factor"]
    page.page.get_by_role("switch", name="lockstep").click()
    wait_until(lambda: page.status.get("target_factor") is not None, "real time again")
    before = page.status["tick"]
    page.page.get_by_label("seed").fill("11")
    page.page.get_by_label("seed").blur()
    page.click("Reset")
    wait_until(
        lambda: page.status["seed"] == 11 and page.status["tick"] < before,
        "a new flight with the seed",
    )
    wait_until(lambda: 0 < page.tick < before, "it is flown")
    return f"pause, step, law, driver, lockstep (factor {fast:.0f}), reset with a seed"


def _slider(page: Page, label: str, share: float) -> None:
    """Drag a slider with the mouse, slowly enough that a faulty page would send every step."""
    slider = page.page.get_by_role("slider", name=label)
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    y = box["y"] + box["height"] / 2
    page.page.mouse.move(box["x"] + 4, y)
    page.page.mouse.down()
    for k in range(1, 11):
        page.page.mouse.move(box["x"] + box["width"] * share * k / 10, y)
        time.sleep(0.04)
    page.page.mouse.up()


def check_links(page: Page) -> str:
    """Check that a slider degrades a link, and that blackout, refusal and reset of the links are shown."""
    name = "uav_0/detections"
    row = page.page.locator(f"[data-link='{name}']")

    def link() -> dict[str, Any]:
        found: dict[str, Any] = page.status["links"][name]
        return found

    row.click()
    wait_until(
        lambda: page.page.get_by_role("combobox", name="link").input_value() == "detections",
        "the form shows the row",
    )
    before = len(page.status["changes"])
    _slider(page, "loss [%]", 0.5)
    wait_until(lambda: 0.3 < link()["settings"]["loss"] < 0.7, "the slider sets the loss")
    share = link()["settings"]["loss"]
    wait_until(lambda: link()["lost"]["loss"] > 0, "detections are lost")
    if (count := len(page.status["changes"]) - before) != 1:
        raise Failed(f"one drag of a slider has sent {count} controls")
    if any(other["degraded"] for key, other in page.status["links"].items() if key != name):
        raise Failed("other links are degraded too")
    wait_until(
        lambda: (
            f"loss {100 * share:.3g} %" in row.inner_text() and "lost: loss" in row.inner_text()
        ),
        "the row shows it",
    )
    page.page.get_by_label("length of the blackout").fill("2")
    page.click("Blackout for 2 s")
    wait_until(
        lambda: "blackout" in row.inner_text() and "left" in row.inner_text(),
        "the row shows the blackout",
    )
    wait_until(lambda: link()["lost"]["blackout"] >= 20, "it takes what is sent meanwhile")
    if link()["settings"]["loss"] != share:
        raise Failed("a blackout has changed the loss")
    wait_until(lambda: "left" not in row.inner_text(), "it passes")
    _slider(page, "Burst length [s]", 0.2)
    wait_until(
        lambda: link()["settings"]["burst_interval"] > 0.0, "bursts come with a time between them"
    )
    interval = page.page.get_by_label("Burst interval, number")
    interval.fill("0")
    interval.press("Enter")
    refusal = page.page.locator("#link-refusal")
    wait_until(
        lambda: "burst_interval" in refusal.inner_text() and "allowed" in refusal.inner_text(),
        "a refusal is shown, and why",
    )
    wait_until(lambda: float(interval.input_value()) > 0.0, "the form shows again what is")
    page.page.get_by_role("button", name="Perfect", exact=True).click()
    wait_until(lambda: not link()["degraded"], "it is perfect again")
    wait_until(
        lambda: not refusal.inner_text() and "perfect" in row.inner_text(), "and the page says so"
    )
    return f"one control for a drag, loss {100 * share:.0f} %; blackout of 2 s; refusal with reason; perfect again"


def check_observer(processes: Processes, context: Any, complaints: list[str]) -> str:
    """Check that an observer sees everything, and why nothing can be changed."""
    page = Page(context, processes.address(OBSERVERS), complaints)
    tick = page.tick
    wait_until(lambda: page.tick > tick, "it moves")
    wait_until(lambda: page.page.locator("#links .link-row").count() == 5, "the links are shown")
    if page.page.get_by_text("read-only").count() != 1:
        raise Failed("an observer does not see why nothing can be changed")
    for button in page.page.locator(".side .q-btn").all():
        if button.is_enabled():
            raise Failed(f"an observer can press {button.inner_text()!r}")
    page.page.close()
    processes.kill(OBSERVERS)
    return "all is shown, nothing can be pressed, and the reason is given"


def check_recording(
    processes: Processes,
    context: Any,
    pictures: Path | None,
    complaints: list[str],
) -> str:
    """Check that a recording plays, pauses, seeks and steps, and that all other controls are disabled."""
    page = Page(context, processes.address("replay"), complaints)
    wait_until(lambda: page.tick > 20, "it is played")
    page.click("Pause")
    wait_until(lambda: page.status["paused"], "it is paused")
    box = page.page.get_by_role("slider", name="time").bounding_box()
    page.page.mouse.click(box["x"] + box["width"] * 0.96, box["y"] + box["height"] / 2)
    wait_until(lambda: page.tick > 300, "it is wound forward")
    tick = page.tick
    page.click("Step")
    wait_until(lambda: page.tick == tick + 1, "it is stepped")
    for name in ("Take control", "Reset", "Perfect", "Blackout"):
        if page.page.get_by_role("button", name=name).is_enabled():
            raise Failed(f"a recording lets one press {name}")
    if page.page.get_by_text("this is a recording").count() != 2:
        raise Failed("it does not say why nothing can be steered")
    page.click("Play")
    wait_until(page.banner, "it says that it is at its end")
    if pictures is not None:
        page.page.screenshot(path=pictures / "recording.png")
    page.click("Play")
    wait_until(lambda: page.tick < 300, "it begins again")
    page.page.close()
    processes.kill("replay")
    return "played, paused, wound, stepped, played again; what steers is disabled, and says why"


def check_dead_simulator(page: Page, processes: Processes) -> str:
    """Check that a dead simulator is reported until the next one runs."""
    processes.kill("simulator")
    began = time.monotonic()
    line = wait_until(page.banner, "the page says that the simulator is gone", 6.0)
    seconds = time.monotonic() - began
    if "simulator" not in line:
        raise Failed(f"the banner says {line!r}")
    processes.simulator(5.0)
    wait_until(lambda: not page.banner(), "the banner goes when the simulator is back", 40.0)
    tick = page.tick
    wait_until(lambda: page.tick != tick and page.speed() > 0.02, "the vehicles move again")
    return f"{line!r} after {seconds:.1f} s; gone with the next simulator"


Refused = dict[str, tuple["subprocess.Popen[str]", str]]
"""Fault -> process that must end, and the expected key phrase."""


def refused_dashboards(processes: Processes, port: int) -> Refused:
    """Start dashboards that must be refused; they take time, so their results are checked later."""
    refused = {
        "a taken port": (["--port", str(port)], "cannot listen"),
        "a host without token": (["--host", "0.0.0.0", "--no-token"], "--no-token"),  # noqa: S104 - which is refused
        "a short token": (["--token", "short"], "--token"),
    }
    tried = {}
    for what, (arguments, phrase) in refused.items():
        command = [*OUTRIDER, "dashboard", *arguments, "--connect", processes.endpoint]
        command += ["--run", RUN, "--credentials", processes.files["operator"]]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        tried[what] = (process, phrase)
    return tried


def check_doors(port: int, second: int, processes: Processes, refused: Refused) -> str:
    """Check who may open the page, also with a chosen token, and the messages for those who may not."""
    for what, (process, phrase) in refused.items():
        errors = process.communicate(timeout=60)[1]
        if process.returncode != 2 or phrase not in errors or len(errors.strip().splitlines()) != 1:
            raise Failed(f"{what}: exit code {process.returncode}, {errors!r}")
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "x" * 22 + "==",
    }
    for headers, status in (
        ({}, 401),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Origin": "http://elsewhere.example"}, 403),
        ({"Origin": "http://["}, 403),
    ):
        _expect(port, "/", headers, status)
        _expect(port, "/frames", {**upgrade, **headers}, status)
    wait_until(lambda: answers(second), "the dashboard with a token listens")
    _expect(second, "/", {}, 401)
    _expect(second, "/frames", upgrade, 401)
    _expect(second, "/?token=not-the-token", {}, 401)
    cookie = _expect(second, f"/?token={TOKEN}", {}, 303)
    _expect(second, "/", {"Cookie": cookie.partition(";")[0]}, 200)
    processes.kill("dashboard_2")
    return "three refusals in one line each; no token, no page; no other site's page gets in"


def _expect(port: int, path: str, headers: dict[str, str], status: int) -> str:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        if response.status != status:
            raise Failed(f"{path} with {headers}: {response.status}, not {status}")
        if "frame-ancestors 'none'" not in (response.getheader("Content-Security-Policy") or ""):
            raise Failed(f"{path} with {headers} may be framed")
        return response.getheader("Set-Cookie") or ""
    finally:
        connection.close()


@contextlib.contextmanager
def staged(port: int) -> Iterator[Processes]:
    """Start the run; print its logs if a check fails."""
    with tempfile.TemporaryDirectory(prefix="o-") as folder:
        processes = Processes(Path(folder))
        try:
            processes.start_all(port)
            yield processes
        except BaseException:
            sys.stderr.write(processes.logs() + "\n")
            raise
        finally:
            processes.end()


def perform(playwright: Any, chromium: str, pictures: Path | None) -> None:
    """Run all checks, in order."""
    port = free_port()
    address = f"http://127.0.0.1:{port}/"
    complaints: list[str] = []

    began = time.monotonic()

    def report(what: str, found: str) -> None:
        say(f"ok {time.monotonic() - began:5.1f} s  {what}: {found}")

    with staged(port) as processes:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", _OFFLINE]
        )
        try:
            desktop = browser.new_context(viewport={"width": 1280, "height": 800})
            phone = browser.new_context(
                viewport={"width": 390, "height": 844}, device_scale_factor=2, has_touch=True
            )
            first = Page(desktop, processes.address("dashboard"), complaints)
            report("what may run in it", check_policy(desktop, address))
            report("the page opens and the vehicles move", check_open_and_moving(first))
            report("at real time", check_frame_rate(first))
            report("reload", check_reload(first))
            processes.replay()
            report("keys", check_key(first))
            report("gamepad", check_pad(first))
            processes.start("dashboard", "--port", str(free_port()), name=OBSERVERS)
            report("a recording", check_recording(processes, desktop, pictures, complaints))
            report("a slider degrades the link", check_links(first))
            report("an observer", check_observer(processes, desktop, complaints))
            second = Page(phone, processes.address("dashboard"), complaints)
            for name, page in (("desktop", first), ("phone", second)):
                if pictures is not None:
                    page.page.screenshot(path=pictures / f"{name}.png")
            report("on a phone", check_phone(second))
            report("zoom", check_zoom(second, phone))
            tablet = browser.new_context(viewport={"width": 820, "height": 1180})
            tablet.add_cookies(phone.cookies())
            report("on a tablet", check_tablet(tablet, address, pictures, complaints))
            report("several browsers", check_one_operator(first, second))
            report("touch", check_touch(second, phone))
            refused, door = refused_dashboards(processes, port), free_port()
            token = ("--port", str(door), "--token", TOKEN)
            processes.start("dashboard", *token, name="dashboard_2")
            third = Page(desktop, address, complaints)
            report("controls", check_controls(third))
            report("a proxy without WebSockets", check_proxy(desktop, port))
            report("a proxy with a path of its own", check_sub_path(browser, door, TOKEN))
            report("three pairs", check_pairs(browser, processes, pictures))
            report("network budget", check_budget(browser, processes, pictures))
            report("a team", check_team(browser, processes, pictures))
            report("a dead simulator", check_dead_simulator(third, processes))
            report("doors", check_doors(port, door, processes, refused))
            if complaints:
                raise Failed("; ".join(complaints[:5]))
            report("the browser", "no errors, and no request left this machine")
        finally:
            browser.close()


def find_browser() -> str:
    """Return the path of Chromium, or an empty string."""
    return next(filter(None, map(shutil.which, (os.environ.get("CHROMIUM", ""), *BROWSERS))), "")


def install_browser() -> None:
    """Install Debian's Chromium if this is Debian and we are root; `missing` reports a failure."""
    if find_browser() or os.getuid() != 0 or shutil.which("apt-get") is None:
        return
    say("page-test: installing chromium from Debian's packages")
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    settings = ("Retries=1", "http::Timeout=20", "https::Timeout=20")
    patient = ["-qq", *(f"-oAcquire::{setting}" for setting in settings)]
    for words in (
        ["update"],
        ["install", "-y", "--no-install-recommends", "chromium", "fonts-dejavu-core"],
    ):
        with contextlib.suppress(subprocess.TimeoutExpired):
            done = subprocess.run(
                ["apt-get", *patient, *words],
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=_INSTALLING,
                check=False,
            )
            if done.returncode:
                reason = done.stderr.strip() or done.stdout.strip() or "no reason given"
                say(f"page-test: apt-get {words[0]} failed: {reason.splitlines()[-1]}")


def missing() -> str:
    """Return a line about a missing requirement, or an empty string."""
    for module, extra in (("playwright", "playwright"), ("nicegui", "-e '.[dashboard]'")):
        try:
            __import__(module)
        except ModuleNotFoundError:
            return f"page-test: skipped: {module} is missing: pip install {extra}"
    if not find_browser():
        return (
            "page-test: skipped: no chromium: apt-get install chromium, or name one in CHROMIUM "
            f"({', '.join(BROWSERS)})"
        )
    return ""


def main() -> int:
    """Run all checks."""
    parser = argparse.ArgumentParser(description="Test the dashboard in a real browser.")
    parser.add_argument(
        "--pictures",
        type=Path,
        help="a folder for pictures of the page on a desktop and on a phone",
    )
    parser.add_argument(
        "--install",
        action="store_true",
        help="get Chromium from Debian's packages if it is not there",
    )
    arguments = parser.parse_args()
    if arguments.install:
        install_browser()
    lacking = missing()
    if lacking:
        sys.stderr.write(lacking + "\n")
        return 77
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - optional

    chromium = find_browser()
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    try:
        with sync_playwright() as playwright:
            perform(playwright, chromium, arguments.pictures)
    except Failed as failure:
        say(f"FAIL  {failure}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
