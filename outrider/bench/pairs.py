"""A scenario with many pairs of vehicles, for the bench and the curious: every UAV escorts a UGV of its own."""

import math

_HEAD = """title = "{count} pairs"
seed = 7
duration = {seconds}
detections.noise = 0.1
detections.dropout = 0.1
"""
_PAIR = """
[[uav]]
name = "uav_{k}"
escorts = "ugv_{k}"
position = [{x:.2f}, {above:.2f}]

[[ugv]]
name = "ugv_{k}"
position = [{x:.2f}, {y:.2f}]
goals = [[{x:.2f}, {up:.2f}], [{across:.2f}, {up:.2f}], [{across:.2f}, {y:.2f}]]
"""


def pairs_toml(count: int, *, seconds: float) -> str:
    """The scenario as TOML.

    The UGVs stand in rows over the paper's area, and each drives along three sides of a square.

    Args:
        count: How many pairs.
        seconds: Duration [s].

    Raises:
        ValueError: If there is none.
    """
    if count < 1:
        raise ValueError(f"count = {count}: allowed is 1 or more")
    columns = math.ceil(math.sqrt(count))
    pitch = 36.0 / columns
    text = _HEAD.format(count=count, seconds=float(seconds))
    for k in range(count):
        row, column = divmod(k, columns)
        x, y, side = 2.0 + pitch * column, 2.0 + pitch * row, 0.4 * pitch
        text += _PAIR.format(k=k, x=x, y=y, above=y + 1.0, up=y + side, across=x + side)
    return text
