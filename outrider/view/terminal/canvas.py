"""Picture of characters: Braille dots on colored cells, with letters over them."""

import math

from rich.segment import Segment
from rich.style import Style

_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a cell's dots, by row and column."""
_BLANK = 0x2800


class Canvas:
    """Canvas of width x height cells with 2 x 4 dots each; (0, 0) is the upper left dot.

    Args:
        width: Width [cells].
        height: Height [cells].
        background: Default color of a cell.
    """

    def __init__(self, width: int, height: int, background: str) -> None:
        self.width, self.height = width, height
        self._background = background
        self._bits = [[0] * width for _ in range(height)]
        self._colors = [[""] * width for _ in range(height)]
        self._grounds = [[background] * width for _ in range(height)]
        self._letters = [[""] * width for _ in range(height)]

    def dot(self, x: float, y: float, color: str) -> None:
        """Set a dot; a cell has the color of its last dot."""
        if not (0.0 <= x < 2 * self.width and 0.0 <= y < 4 * self.height):
            return
        column, row = int(x) // 2, int(y) // 4
        self._bits[row][column] |= _DOTS[int(y) % 4][int(x) % 2]
        self._colors[row][column] = color

    def line(
        self, x0: float, y0: float, x1: float, y1: float, color: str, *, dashed: bool = False
    ) -> None:
        """Draw a line of dots."""
        steps = min(int(max(abs(x1 - x0), abs(y1 - y0))) + 1, 10_000)
        for step in range(steps + 1):
            if dashed and step % 4 >= 2:
                continue
            share = step / steps
            self.dot(x0 + (x1 - x0) * share, y0 + (y1 - y0) * share, color)

    def circle(
        self, x: float, y: float, radius: float, color: str, *, dashed: bool = False
    ) -> None:
        """Draw a circle of dots."""
        steps = min(max(int(2.0 * math.pi * radius), 8), 10_000)
        for step in range(steps):
            if not (dashed and step % 6 >= 3):
                angle = 2.0 * math.pi * step / steps
                self.dot(x + radius * math.cos(angle), y + radius * math.sin(angle), color)

    def ground(self, column: int, row: int, color: str) -> None:
        """Set the background color of a cell."""
        self._grounds[row][column] = color

    def letter(self, x: float, y: float, text: str, color: str) -> None:
        """Write a text over the dots, from the cell of a dot on."""
        if not (0.0 <= y < 4 * self.height):
            return
        row, first = int(y) // 4, math.floor(x) // 2
        for column, letter in enumerate(text, first):
            if 0 <= column < self.width:
                self._letters[row][column] = letter
                self._colors[row][column] = color

    def row(self, row: int) -> list[Segment]:
        """Return one line of the canvas."""
        segments: list[Segment] = []
        text, style = "", ("", "", False)
        for column in range(self.width):
            letter = self._letters[row][column]
            own = (self._colors[row][column], self._grounds[row][column], bool(letter))
            if own != style and text:
                segments.append(_segment(text, *style))
                text = ""
            style = own
            text += letter or (
                chr(_BLANK | self._bits[row][column]) if self._bits[row][column] else " "
            )
        if text:
            segments.append(_segment(text, *style))
        return segments


def _segment(text: str, color: str, ground: str, bold: bool) -> Segment:
    return Segment(text, Style(color=color or None, bgcolor=ground, bold=bold))
