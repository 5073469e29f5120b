"""The standard files of a process: open whatever its caller has closed, and named in errors."""

import os
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


def open_standard_files() -> None:
    """Open /dev/null in the place of standard files that the caller has closed.

    Otherwise they are None to Python, and the next files that are opened get their numbers.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, mode))
