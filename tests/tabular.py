"""Tables of cases as text, one row per line, cells separated by bars, for tests of many refusals."""


def rows(text: str) -> list[list[str]]:
    """Return the cells of each row; a line that begins with a bar or `&` continues the previous row."""
    lines = text.replace("\n|", " |").replace("\n&", " &").strip().splitlines()
    return [[cell.strip() for cell in line.split(" | ")] for line in lines]


def words(text: str) -> list[str]:
    """Split a text at white space."""
    return text.split()
