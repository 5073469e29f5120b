"""Checks that a scenario or other input is refused in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bus.errors import ScenarioError
from sim.scenario.loading import load_scenario
from tabular import words

SHIPPED = tuple(
    words("""
escort circle circle-too-fast courtyard figure-1-bounded figure-1-high-gain figure-1-low-gain
figure-3-linear figure-3-logarithmic figure-3-switching minefield relay rescue rescue-town rubble scenario-1
scenario-2 scouts town
""")
)
SMALL = "[[uav]]\nposition = [6.0, 21.0]\n[[ugv]]\nposition = [6.0, 20.0]\ngoals = [[34.0, 20.0]]\n"
"""The smallest valid scenario."""


def refusal(source="escort", overrides=()) -> str:
    """Return the line with which a scenario is refused."""
    with pytest.raises(ScenarioError) as caught:
        load_scenario(source, overrides=overrides)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    assert line.isprintable()
    return line


def written(folder: Path, content: bytes) -> Path:
    path = folder / "mine.toml"
    path.write_bytes(content)
    return path


@contextmanager
def refused(
    kind: type[Exception] | tuple[type[Exception], ...], words: str
) -> Iterator["pytest.ExceptionInfo[Exception]"]:
    """Expect an error of this kind whose single line matches these words."""
    with pytest.raises(kind, match=words) as caught:
        yield caught
    assert "\n" not in str(caught.value)
