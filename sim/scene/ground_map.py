"""Ground with hazards for observers: its true state, and the UGVs' knowledge."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from bus.messages.base import Vector
from bus.messages.ground import GroundMap, Hazard
from bus.registry import HAZARDS
from sim.engine.ground_state import GroundState
from sim.models.ground import CLEAR, UNSEEN, TileArray, fill_tiles
from sim.models.hazards import FOUND
from sim.world import World

SEEN = 5
"""Code of a tile that a UAV has observed but not yet sent; the other codes are the states of a tile."""
UNKNOWN, KNOWN, HIT = range(3)
"""States of a hazard."""
_NO_ROUTES: Mapping[str, tuple[Vector, ...]] = MappingProxyType({})
_KINDS = {row.code: name for name, row in HAZARDS.items()}


def hazards_of(world: World) -> tuple[Hazard, ...]:
    """Return the hazards of a world: the scenario's, the buildings as blocks, and the random ones of this run."""
    ground = world.ground
    if ground is None:
        return ()
    given, rows, end = world.scenario.hazard, ground.hazards[0], _buildings(ground).stop
    buildings, drawn = rows[_buildings(ground)], rows[end:]
    blocks = (
        ground.corners[row["first"] : row["first"] + row["corners"]].tolist()
        for row in buildings[buildings["kind"] > 0]
    )
    houses = (Hazard(kind="block", polygon=tuple((x, y) for x, y in block)) for block in blocks)
    return (
        *given,
        *houses,
        *(
            Hazard(
                kind=_KINDS[int(row["kind"])],
                center=(float(row["x"]), float(row["y"])),
                radius=float(row["radius"]),
                speed_share=float(row["share"]),
            )
            for row in drawn[drawn["kind"] > 0]
        ),
    )


def _buildings(ground: GroundState) -> slice:
    """Return the rows of the buildings among the hazards."""
    parameters = ground.parameters[0]
    return slice(int(parameters["first_building"]), int(parameters["end_building"]))


def _mapped_tiles(world: World, ground: GroundState) -> TileArray:
    """Return the state of each tile as the map of the buildings shows it; UNSEEN: it does not."""
    tiles: TileArray = ground.tiles[0].copy()
    if ground.parameters["mapped"][0]:
        return tiles
    tiles[...] = UNSEEN
    if world.scenario.has_buildings and world.scenario.buildings.known:
        fill_tiles(
            ground.hazards[0, _buildings(ground)], ground.corners, world.scenario.ground.tile, tiles
        )
        tiles[tiles == CLEAR] = UNSEEN
    return tiles


def _ahead(route: tuple[Vector, ...], position: Vector) -> tuple[Vector, ...]:
    """Return the rest of a route from a position on or near it; routes are given by their corners [m]."""
    corners = np.array(route)
    sides = np.diff(corners, axis=0)
    length2 = np.maximum((sides**2).sum(axis=1), 1e-12)
    share = (((np.array(position) - corners[:-1]) * sides).sum(axis=1) / length2).clip(0.0, 1.0)
    away = np.hypot(*(corners[:-1] + share[:, None] * sides - position).T)
    return (position, *route[int(away.argmin()) + 1 :])


def ground_map(
    world: World,
    hazards: tuple[Hazard, ...] | None = None,
    routes: Mapping[str, tuple[Vector, ...]] = _NO_ROUTES,
) -> GroundMap | None:
    """Return the current ground of a world; None: no hazards.

    Args:
        world: World to show.
        hazards: Its hazards from an earlier call; they are constant.
        routes: Planned route of each UGV, as last reported: its corners [m].
    """
    ground = world.ground
    if ground is None:
        return None
    rows, columns = ground.tiles.shape[1:]
    tiles = _mapped_tiles(world, ground)
    for n, v in enumerate(ground.ugvs.tolist()):
        sensed = ground.known[0, v]
        own = np.where(sensed == UNSEEN, ground.radioed[0, n], sensed)
        tiles = np.where(tiles == UNSEEN, own, tiles)
    for v in world.escorts[:, 0].tolist():
        tiles[(tiles == UNSEEN) & (ground.known[0, v] != UNSEEN)] = SEEN
    kinds, buildings = ground.hazards[0]["kind"], _buildings(ground)
    known = np.where(kinds == FOUND, ground.found[0] > 0, (ground.warned[0] > 0).any(axis=0))
    states = np.where(ground.hits[0].any(axis=0), HIT, np.where(known, KNOWN, UNKNOWN))
    positions = dict(zip(world.names, world.position.tolist(), strict=True))
    return GroundMap(
        tick=world.tick,
        rows=rows,
        columns=columns,
        tile=world.scenario.ground.tile,
        tiles=tiles.tobytes(),
        states=states[kinds > 0].astype(np.uint8).tobytes(),
        routes={
            name: _ahead(route, tuple(positions[name]))
            for name, route in routes.items()
            if len(route) > 1
        },
        hazards=hazards_of(world) if hazards is None else hazards,
        first_building=buildings.start,
        end_building=buildings.start + int((kinds[buildings] > 0).sum()),
    )
