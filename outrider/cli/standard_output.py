"""Standard output, with errors that name it."""

import sys
from pathlib import Path

from bus.files import writing

STANDARD_OUTPUT = Path("standard output")
"""Its name in errors."""


def print_text(text: str) -> None:
    """Write a text to standard output at once.

    Raises:
        OSError: If it cannot be written; the error names standard output.
    """
    with writing(STANDARD_OUTPUT):
        sys.stdout.write(text)
        sys.stdout.flush()
