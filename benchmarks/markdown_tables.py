"""Tables of the benchmarks, in Markdown."""

import sys
from collections.abc import Callable, Iterator, Mapping


def head(columns: str) -> str:
    """The two lines with which a table begins; the columns' names between bars."""
    return f"| {columns} |\n|{'---|' * len(columns.split(' | '))}"


def print_chosen(tables: Mapping[str, Callable[[], Iterator[str]]], about: str | None) -> None:
    """Print the table that the command line names, line by line as it comes.

    Args:
        tables: All there are, by name.
        about: What the program is, for whoever names none.
    """
    if len(sys.argv) != 2 or sys.argv[1] not in tables:
        sys.exit(f"{about}\ntable = {' '.join(sys.argv[1:])!r}; allowed: {', '.join(tables)}")
    for line in tables[sys.argv[1]]():
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
