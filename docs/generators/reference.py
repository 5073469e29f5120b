"""Generated text of the documentation: `make reference` writes it between the marks of the pages.

`<!-- NAME -->` and `<!-- /NAME -->` enclose the text of the generator NAME. The marks of measured results, such as
`bench`, have no generator.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import bus_messages
import command_line
import fmi_variables
import metric_tables
import observations
import python_modules
import reading_list
import ros2_topics
import scenario_fields
import scenario_schema

ROOT = Path(__file__).resolve().parent.parent.parent
COMMAND = "make reference"
GENERATED = {
    "command_line": command_line.page,
    "scenario_tables": scenario_fields.tables,
    "scenarios_shipped": scenario_fields.shipped,
    "metrics": metric_tables.tables,
    "bus_keys": bus_messages.keys,
    "bus_messages": bus_messages.messages,
    "python_modules": python_modules.table,
    "reading_list": reading_list.table,
    "fmi_pilots": fmi_variables.pilots,
    "fmi_world": fmi_variables.world,
    "fmi_driver": fmi_variables.driver,
    "ros2_topics": ros2_topics.observed,
    "ros2_pilot_topics": ros2_topics.own,
    **observations.PAGES,
}
"""Generators by the names of their marks."""

_BETWEEN = re.compile(r"^<!-- (\w+) -->\n.*?^<!-- /\1 -->$", re.DOTALL | re.MULTILINE)


def pages() -> list[Path]:
    """Return the pages of the repository that may contain generated text."""
    docs, extensions = ROOT.glob("docs/**/*.md"), ROOT.glob("extensions/*/README.md")
    return [ROOT / "README.md", *sorted(docs), *sorted(extensions)]


def current(text: str) -> str:
    """Return a page with the current text between its marks."""

    def generated(found: re.Match[str]) -> str:
        name = found[1]
        if name not in GENERATED:
            return found[0]
        return f"<!-- {name} -->\n\n{GENERATED[name]()}\n\n<!-- /{name} -->"

    return _BETWEEN.sub(generated, text)


def outdated() -> Iterator[tuple[Path, str]]:
    """Yield each file whose generated text is not current, and the text that it should have."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        wanted = current(text)
        if wanted != text:
            yield page, wanted
    schema = scenario_schema.FILE
    wanted = scenario_schema.schema_text()
    if not schema.is_file() or schema.read_text(encoding="utf-8") != wanted:
        yield schema, wanted


def missing() -> list[str]:
    """Return the commands whose libraries are missing here, so that the reference would lack them."""
    shown = {name for name, command in command_line.commands().items() if not command.hidden}
    return sorted(command_line.extensions().keys() - shown)


if __name__ == "__main__":
    if missing():
        sys.exit(
            f"commands without their libraries: {', '.join(missing())}; {COMMAND} installs them"
        )
    for file, text in outdated():
        file.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{file.relative_to(ROOT)}\n")
