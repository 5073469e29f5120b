"""Checks of hazards, one function each."""

import itertools
import math
from collections.abc import Iterator

import msgspec
import numpy as np

from bus.messages.ground import Hazard
from bus.numbers import above, at_least, exact
from bus.registry import CAUTIONS, DRIVERS, HAZARDS, TOUCHES
from sim.input.faults import Fault, unknown_name
from sim.models.buildings import tables_of
from sim.models.ground import TileArray, span, tile_index
from sim.models.hazards import BLOCK, TOUCH, crosses_hazard, hazard_at
from sim.scenario.building_tables import run_buildings
from sim.scenario.ground_tables import (
    corners_of,
    first_corner,
    ground_tables,
    hazard_rows,
    place_buildings,
    place_fields,
)
from sim.scenario.ground_types import MOST_HAZARDS, HazardField
from sim.scenario.polygon_checks import polygon_faults
from sim.scenario.stops import all_stops, stops
from sim.scenario.types import Scenario
from sim.scenario.world_checks import Check

_MOST_TILES = 1_000_000
_MOST_GROUND = 4.0
"""Largest total area of a field's discs, as a share of the area: half of it already blocks most routes."""
_ROUNDING = 1e-9


def hazards_are_known(scenario: Scenario) -> Iterator[Fault]:
    """Check that kinds of hazards, effects of contact and cautions are registered."""
    for k, hazard in enumerate(scenario.hazard):
        yield from unknown_name(f"hazard.{k}.kind", hazard.kind, HAZARDS)
    for k, field in enumerate(scenario.hazard_field):
        yield from unknown_name(f"hazard_field.{k}.kind", field.kind, HAZARDS)
    yield from unknown_name("ground.touch", scenario.ground.touch, TOUCHES)
    for k, ugv in enumerate(scenario.ugv):
        yield from unknown_name(f"ugv.{k}.caution", ugv.caution, CAUTIONS)


def tiles_fit_area(scenario: Scenario) -> Iterator[Fault]:
    """Check that tiles are smaller than the area, not smaller than the grid's cells, and not too many."""
    if not scenario.has_ground:
        return
    tile, area = scenario.ground.tile, scenario.area
    side, cell = min(area.width, area.height), area.cell
    least = max(cell, math.sqrt(area.width) * math.sqrt(area.height / _MOST_TILES))
    allowed = f"{at_least(least, 3)} to {exact(side)} m"
    if tile > side:
        yield Fault("ground.tile", tile, "wider than the area", allowed)
    elif tile < cell * (1.0 - _ROUNDING):
        yield Fault("ground.tile", tile, f"smaller than area.cell = {exact(cell)} m", allowed)
    else:
        tiles = math.ceil(area.width / tile) * math.ceil(area.height / tile)
        if tiles > _MOST_TILES:
            wrong = f"makes {above(tiles, _MOST_TILES, 3)} tiles, more than {_MOST_TILES:,}"
            yield Fault(
                "ground.tile", tile, wrong, f"{at_least(least * 1.01, 3)} to {exact(side)} m"
            )


def hazards_have_a_shape(scenario: Scenario) -> Iterator[Fault]:
    """Check that each hazard is a disc or a polygon, and that only rough ones have a speed share."""
    for k, hazard in enumerate(scenario.hazard):
        path = f"hazard.{k}"
        yield from _share_fault(path, hazard)
        if hazard.polygon and (hazard.center is not None or hazard.radius is not None):
            yield Fault(
                f"{path}.polygon", hazard.polygon, "also a disc", "either a disc or a polygon"
            )
        elif hazard.polygon:
            yield from polygon_faults(f"{path}.polygon", hazard.polygon)
        elif hazard.center is None:
            wrong = "missing" if hazard.radius is not None else "neither a disc nor a polygon"
            allowed = "[x, y] in m, with radius, or a polygon instead"
            yield Fault(f"{path}.center", None, wrong, allowed)
        elif hazard.radius is None:
            yield Fault(f"{path}.radius", None, "missing", "a number > 0, in m")


def _share_fault(path: str, hazard: Hazard | HazardField) -> Iterator[Fault]:
    if hazard.speed_share is not None and not HAZARDS[hazard.kind].slows:
        rough = ", ".join(name for name, row in HAZARDS.items() if row.slows)
        wrong = f"the kind {hazard.kind!r} does not slow vehicles"
        yield Fault(
            f"{path}.speed_share", hazard.speed_share, wrong, f"kind {rough}, or no speed_share"
        )


def _position_field(k: int, hazard: Hazard) -> tuple[str, object]:
    """Return the field with a hazard's position, and its value."""
    if hazard.polygon:
        return f"hazard.{k}.polygon", hazard.polygon
    return f"hazard.{k}.center", hazard.center


def hazards_lie_in_area(scenario: Scenario) -> Iterator[Fault]:
    """Check that each hazard overlaps Q, and that objects to find lie inside."""
    width, height = scenario.area.width, scenario.area.height
    allowed = f"[0, {exact(width)}] x [0, {exact(height)}] m"
    for k, hazard in enumerate(scenario.hazard):
        low, high = hazard.bounds
        radius = hazard.radius or 0.0
        if hazard.kind == "find":
            if not (low[0] >= 0.0 and low[1] >= 0.0 and high[0] <= width and high[1] <= height):
                yield Fault(*_position_field(k, hazard), "object to find outside Q", allowed)
        elif (
            max(-high[0], low[0] - width, 0.0) > radius
            or max(-high[1], low[1] - height, 0.0) > radius
        ):
            yield Fault(*_position_field(k, hazard), "outside Q", allowed)


def starts_and_goals_are_free(scenario: Scenario) -> Iterator[Fault]:
    """Check that no blocking hazard covers a start or a goal."""
    if not any(not HAZARDS[hazard.kind].drivable for hazard in scenario.hazard):
        return
    rows, corners = hazard_rows(scenario.hazard), corners_of(scenario.hazard)
    for path, (x, y) in all_stops(scenario):
        k = hazard_at(rows, corners, BLOCK, x, y)
        if k >= 0:
            wrong = f"covers {path} = [{exact(x)}, {exact(y)}]"
            yield Fault(
                *_position_field(k, scenario.hazard[k]),
                wrong,
                "a position away from all starts and goals",
            )


def routes_are_open(scenario: Scenario) -> Iterator[Fault]:
    """Check that a route over free tiles, clear of buildings, leads from each UGV's start to all its goals."""
    blocking = any(not HAZARDS[hazard.kind].drivable for hazard in scenario.hazard)
    if not (blocking or scenario.building):
        return
    from scipy.ndimage import label  # noqa: PLC0415 - it takes long to load, and few need it

    tile, tiles = scenario.ground.tile, ground_tables(scenario).closed
    regions, _ = label(tiles != BLOCK)
    allowed = f"a route of adjacent {exact(tile)} m tiles without hazards"
    on_tile, what = "a blocking hazard touches its tile", "hazards"
    if scenario.building:
        allowed += f", more than building_clearance = {exact(scenario.max_building_clearance)} m from buildings"
        on_tile, what = "a hazard or a building is too near to its tiles", "hazards or buildings"
    start = 0
    for path, (x, y) in all_stops(scenario):
        region = regions[tile_index(y, tile, tiles.shape[0]), tile_index(x, tile, tiles.shape[1])]
        start = region if path.endswith("position") else start
        if region == 0 or (scenario.building and _touches_block(tiles, tile, x, y)):
            yield Fault(path, [x, y], on_tile, allowed)
        elif region != start:
            yield Fault(path, [x, y], f"{what} block every route from the start", allowed)


def _touches_block(tiles: TileArray, tile: float, x: float, y: float) -> bool:
    """Return whether a point touches a blocked tile: on an edge it touches several, and a cautious UGV enters none."""
    rows = slice(*span(y - TOUCH, y + TOUCH, tile, tiles.shape[0]))
    columns = slice(*span(x - TOUCH, x + TOUCH, tile, tiles.shape[1]))
    return bool((tiles[rows, columns] == BLOCK).any())


def fields_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that radii are in order, that only rough fields have a speed share, and the number of hazards."""
    count, area = len(scenario.hazard), scenario.area.width * scenario.area.height
    for k, field in enumerate(scenario.hazard_field):
        path, (smallest, largest) = f"hazard_field.{k}", field.radius
        yield from _share_fault(path, field)
        if smallest > largest:
            yield Fault(f"{path}.radius", field.radius, "out of order", "[smallest, largest] in m")
        count += field.count
        if count > MOST_HAZARDS:
            wrong = f"makes {count:,} hazards in total"
            yield Fault(f"{path}.count", field.count, wrong, f"up to {MOST_HAZARDS:,} in total")
        one = math.pi * (smallest * smallest + smallest * largest + largest * largest) / 3.0
        if one * field.count > _MOST_GROUND * area:
            most = int(_MOST_GROUND * area / one)
            wrong = f"makes {one * field.count:.3g} m² of hazards on {area:.3g} m² of ground"
            allowed = f"up to {most}" if most else "smaller ones"
            yield Fault(f"{path}.count", field.count, wrong, allowed)


def fields_have_room(scenario: Scenario) -> Iterator[Fault]:
    """Check by one trial that all hazards of the fields fit; a run has as many as fit."""
    placed = 0
    for k, field in enumerate(scenario.hazard_field):
        fit = _placed(scenario, scenario.hazard_field[: k + 1]) - placed
        if fit < field.count:
            wrong = f"only {fit} fit" if fit else "none fit"
            allowed = (
                f"up to {fit}, or smaller ones" if fit else "smaller ones, or a smaller clearance"
            )
            yield Fault(f"hazard_field.{k}.count", field.count, wrong, allowed)
        placed += fit


def _placed(scenario: Scenario, fields: tuple[HazardField, ...]) -> int:
    """Return the number of hazards that these fields place in a trial."""
    trial = msgspec.structs.replace(scenario, hazard_field=fields)
    tables = ground_tables(trial)
    key = np.uint64(scenario.seed), np.uint64(0)  # any key: runs use others
    with np.errstate(
        over="ignore"
    ):  # unsigned random numbers wrap around, which the interpreter reports
        if scenario.building_field:
            buildings = run_buildings(trial, key)
            tables = place_buildings(trial, tables, buildings, first_corner(trial, tables, 0))
        return place_fields(trial, tables, key) - tables.buildings.stop


def hazard_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of drivers that ignore hazards, and of straight legs that cross one."""
    if not scenario.has_ground:
        return
    for k, ugv in enumerate(scenario.ugv):
        if DRIVERS[ugv.driver].avoids:
            continue
        crossed = ""
        if ugv.driver == "waypoints":
            crossed = next((f"; {leg}" for leg in _crossing_legs(scenario, k)), "")
        yield (
            f'ugv.{k}.driver = "{ugv.driver}": does not avoid hazards{crossed}; the driver "navigate" does'
        )


def _crossing_legs(scenario: Scenario, k: int) -> Iterator[str]:
    """Describe each straight leg between goals of a UGV that crosses a hazard or a building of the scenario."""
    shapes = {
        "hazard": (hazard_rows(scenario.hazard), corners_of(scenario.hazard)),
        "building": tables_of(scenario.building),
    }
    kinds = [row.code for row in HAZARDS.values() if row.slows or not row.drivable]
    legs = enumerate(itertools.pairwise(stops(scenario.ugv[k])))
    for (n, (start, goal)), kind, name in itertools.product(legs, kinds, shapes):
        crossed, _ = crosses_hazard(*shapes[name], kind, start, goal)
        if crossed >= 0:
            begin = f"goals.{n - 1}" if n else "position"
            yield f"its leg from {begin} to goals.{n} crosses {name}.{crossed}"


GROUND_CHECKS: tuple[Check, ...] = (
    tiles_fit_area,
    hazards_have_a_shape,
    hazards_lie_in_area,
    starts_and_goals_are_free,
    routes_are_open,
    fields_are_possible,
    fields_have_room,
)
"""Checks in order, after those of numbers and names."""
