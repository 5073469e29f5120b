"""Markdown tables of the benchmarks."""

import sys
from collections.abc import Callable, Iterator, Mapping


def head(columns: str) -> str:
    """Return the two head lines of a table from the column names, separated by bars."""
    return f"| {columns} |\n|{'---|' * len(columns.split(' | '))}"


def print_chosen(tables: Mapping[str, Callable[[], Iterator[str]]], about: str | None) -> None:
    """Print the table selected on the command line, line by line.

    Args:
        tables: Tables by name.
        about: Description of the program, printed if no table is selected.
    """
    if len(sys.argv) != 2 or sys.argv[1] not in tables:
        sys.exit(
            f"{about}\ntable = {' '.join(sys.argv[1:])!r}: unknown table; allowed: {', '.join(tables)}"
        )
    for line in tables[sys.argv[1]]():
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
