"""Files of a report: the page and its pictures."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from bus.files import writing
from outrider.experiments.report.document import markdown, page
from outrider.experiments.report.plots import draw_all
from outrider.experiments.report.results import Material, read_material


class Report(NamedTuple):
    """Report that has been written."""

    material: Material
    pictures: dict[str, Path]
    page: Path

    def markdown(self) -> str:
        """Return the tables as Markdown."""
        return markdown(self.material)


def write_report(
    folders: Sequence[Path], out: Path | None, command: str, on_notice: Callable[[str], None]
) -> Report:
    """Write the page and the pictures of sweeps.

    Args:
        folders: Folders of the sweeps.
        out: Folder for the files; None: `report` in the only folder, or here.
        command: Command line that the page names.
        on_notice: Called with one line for the user, if a row is skipped.

    Raises:
        ScenarioError: If a folder is not a sweep's.
        OSError: If a file cannot be written.
    """
    material = read_material(folders, on_notice)
    where = out or (folders[0] / "report" if len(material.folders) == 1 else Path("report"))
    where.mkdir(parents=True, exist_ok=True)
    pictures = draw_all(material, where)
    file = where / "report.html"
    with writing(file):
        file.write_text(page(material, pictures, command), encoding="utf-8")
    return Report(material, pictures, file)
