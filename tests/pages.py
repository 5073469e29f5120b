"""Pages of the documentation and their code, for tests that compare them with the program."""

import json
import re
from pathlib import Path
from typing import Any

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        ROOT / "SECURITY.md",
        *sorted((ROOT / "docs").rglob("*.md")),
        *sorted(ROOT.glob("extensions/*/README.md")),
    )
}


def blocks(language: str, page: str) -> list[str]:
    """Return the fenced blocks of a page in this language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGES[page], flags=re.DOTALL)


def marked(mark: str, page: str) -> list[list[str]]:
    """Return the table between two marks: the cells of its header and of each row."""
    shown = PAGES[page].split(f"<!-- {mark} -->\n")[1].split(f"<!-- /{mark} -->", maxsplit=1)[0]
    head, _, *rows = [line.strip("| ").split(" | ") for line in shown.strip().splitlines()]
    return [head, *rows]


def run_shown(block: str, page: str) -> None:
    """Execute a block of a page."""
    exec(compile(block, page, "exec"), {})  # noqa: S102 - our own page


def words(picture: Path) -> Any:
    """Return the words that a picture states; None if it states none."""
    with Image.open(picture) as opened:
        return json.loads(opened.info.get("Description", "null"))
