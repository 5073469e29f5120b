"""A scenario with many pairs of vehicles, for the bench and the curious: every UAV escorts a UGV of its own."""

import math

from bus.registry import DEFAULT_LAW
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario


def many_pairs(count: int, *, seconds: float) -> Scenario:
    """The scenario `escort` with so many pairs, under the paper's law.

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
    uavs, ugvs = [], []
    for k in range(count):
        row, column = divmod(k, columns)
        x, y, side = 2.0 + pitch * column, 2.0 + pitch * row, 0.4 * pitch
        places = ((x, y + 1.0), (x, y), (x, y + side), (x + side, y + side), (x + side, y))
        above, here, *goals = [(round(east, 2), round(north, 2)) for east, north in places]
        uavs.append({"name": f"uav_{k}", "escorts": f"ugv_{k}", "position": above})
        ugvs.append({"name": f"ugv_{k}", "position": here, "goals": goals})
    told = {"name": f"pairs-{count}", "title": f"{count} pairs", "duration": seconds}
    told |= {"law.name": DEFAULT_LAW, "uav": uavs, "ugv": ugvs}
    return load_scenario("escort", overrides=told)
