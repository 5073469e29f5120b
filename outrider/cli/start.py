"""Start of the command line: imports take a second, in which Ctrl-C must also end it in one line."""

import sys
from typing import NoReturn

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def main() -> NoReturn:
    """Run the command line, and exit."""
    try:
        from outrider.cli.main import main as run  # noqa: PLC0415 - inside the try

        run()
    except KeyboardInterrupt:
        sys.stderr.write("outrider: interrupted\n")
        sys.exit(INTERRUPTED)
