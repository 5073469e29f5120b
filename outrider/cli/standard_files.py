"""Standard files of a process: reopened if the caller has closed them, and named in errors."""

import os
import sys
from pathlib import Path

from bus.files import writing

STANDARD_OUTPUT = Path("standard output")
"""Name of standard output in errors."""


def print_text(text: str) -> None:
    """Write a text to standard output at once.

    Raises:
        OSError: If it cannot be written; the error names standard output.
    """
    with writing(STANDARD_OUTPUT):
        sys.stdout.write(text)
        sys.stdout.flush()


def print_starting() -> None:
    """Print on a terminal that the first start takes about 30 s; a vehicle's process loads no console for it."""
    if sys.stderr.isatty():
        sys.stderr.write("starting (the first start compiles for about 30 s)\n")


def open_standard_files() -> None:
    """Open /dev/null in place of standard files that the caller has closed.

    Otherwise they are None in Python, and the next open files get their descriptors.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, os.O_RDWR)  # the lowest free descriptor
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, mode))
