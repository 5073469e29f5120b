"""Checks of the page with a team: tiles with roles, requests of the operator, map, and assumptions."""

from pathlib import Path
from typing import Any

from page_stage import Failed, Page, Processes, wait_until

_TEAM = """title = "A team"
duration = 2000.0
law.name = "certified"

[team]

[[uav]]
position = [10.0, 11.0]
max_speed = 0.6
max_acceleration = 0.3

[[uav]]
position = [11.0, 11.0]
max_speed = 0.6
max_acceleration = 0.3

[[ugv]]
position = [10.0, 10.0]
max_speed = 0.2
max_acceleration = 0.1
goals = [[18.0, 10.0], [18.0, 30.0], [30.0, 30.0]]
"""
_TILES = """[...document.querySelectorAll(".tile.uav")].map((one) => ({ uav: one.dataset.uav,
  role: one.querySelector("output").innerText, number: one.querySelector(".number").innerText,
  button: one.querySelector("button").innerText, cut: one.scrollWidth > one.clientWidth + 1,
  inside: one.getBoundingClientRect().bottom <= innerHeight }))"""
_GUARDS = (
    "Object.values(outrider.store.status.roles || {}).filter((role) => role === 'GUARD').length"
)


def check_team(browser: Any, processes: Processes, pictures: Path | None) -> str:
    """Check the tiles of a team, and that a click on `Relieve` makes a hand-over without an uncertified tick."""
    processes.compile(_TEAM)
    run = processes.run(_TEAM, "--realtime", "2", name="team")
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light")
    page = Page(context, processes.address("team"), complaints)
    wait_until(lambda: page.run(_GUARDS) == 1 and page.tick > 100, "one UAV guards", 200.0)
    wait_until(lambda: "guard" in {one["role"] for one in page.run(_TILES)}, "a tile shows it")
    tiles = {one["uav"]: one for one in page.run(_TILES)}
    if len(tiles) != 2 or any(one["cut"] or not one["inside"] for one in tiles.values()):
        raise Failed(f"tiles of a team: {tiles}")
    guard = next(name for name, one in tiles.items() if one["role"] == "guard")
    if (tiles[guard]["button"], tiles[guard]["number"][:4]) != ("Relieve", "no. "):
        raise Failed(f"the tile of the guard: {tiles[guard]}")
    if pictures is not None:
        page.page.screenshot(path=pictures / "team.png")
    page.page.locator(f".tile.uav[data-uav={guard}] button").click()
    wait_until(
        lambda: page.status["roles"].get(guard) == "SCOUT" and page.run(_GUARDS) == 1,
        "the guard is relieved",
        60.0,
    )
    text = page.page.locator("#changes").inner_text()
    if f"{guard}: relief requested" not in text:
        raise Failed(f"the request is not among the changes: {text!r}")
    rows = page.page.locator("#processes").inner_text()
    if any(name not in rows for name in ("T1 messages", "T2 numbers", "T3 charge")):
        raise Failed(f"an assumption of a team is missing: {rows!r}")
    drawn = page.run("document.querySelector('.map-card .legend').innerText")
    if "scout" not in drawn or "cell of a UAV" not in drawn:
        raise Failed(f"not in the legend: {drawn!r}")
    if complaints:
        raise Failed("; ".join(complaints[:5]))
    context.close()
    run.terminate()
    run.wait(20.0)
    return f"{guard} is relieved at a click"
