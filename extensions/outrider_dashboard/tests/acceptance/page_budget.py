"""Checks of the page of the network budget."""

from pathlib import Path
from typing import Any

from page_stage import Failed, Page, Processes, wait_until

_SCENARIO = """title = "A budget"
duration = 60.0

[[uav]]
position = [10.0, 11.0]

[[ugv]]
position = [10.0, 10.0]
goals = [[18.0, 10.0]]

[law]
name = "certified"
"""
_SIZES = ((1280, 800), (390, 844))
_ROWS = (5, 8)
"""Bounds of a UAV, and properties of its two links."""


def check_budget(browser: Any, processes: Processes, pictures: Path | None) -> str:
    """Check that a computation is cancelled, seen by all browsers, and shown light and dark, wide and narrow."""
    run = processes.run(_SCENARIO, "--realtime", "0.5", name="budget")
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light")
    page = Page(context, processes.address("budget"), complaints).page
    page.get_by_role("link", name="Network budget").click()
    compute, cancel = (page.get_by_role("button", name=name) for name in ("Compute", "Cancel"))
    compute.click()
    cancel.click()
    wait_until(lambda: not cancel.is_visible() and compute.is_enabled(), "it is cancelled")
    if page.locator(".budget-table").count():
        raise Failed("a cancelled computation shows a table")
    compute.click()
    other = context.new_page()
    other.goto(page.url)
    wait_until(other.get_by_role("button", name="Cancel").is_visible, "the other browser sees it")
    for one in (page, other):
        wait_until(lambda one=one: one.locator(".budget-table").count() == 2, "a budget", 240.0)
    rows = [other.locator(".budget-table").nth(k).locator("tbody tr").count() for k in (0, 1)]
    if tuple(rows) != _ROWS:
        raise Failed(f"rows of the tables: {rows}")
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        for width, height in _SIZES:
            page.set_viewport_size({"width": width, "height": height})
            if page.evaluate("() => document.documentElement.scrollWidth > innerWidth"):
                raise Failed(f"the budget is wider than {width} pixels")
            if pictures is not None:
                page.screenshot(path=pictures / f"budget-{theme}-{width}.png", full_page=True)
    page.get_by_role("link", name="Back to the run").click()
    wait_until(lambda: page.evaluate("() => Boolean(window.outrider)"), "the run is shown again")
    if complaints:
        raise Failed("; ".join(complaints[:5]))
    context.close()
    run.terminate()
    run.wait(20.0)
    return "cancelled, computed once for two browsers, light and dark, wide and narrow"
