"""The speed of each layer, and in the same run the limit that it stands beside."""

from outrider.bench.measured import ROWS, Row, measure

__all__ = ["ROWS", "Row", "measure"]
