"""Observation of an agent: its vehicle's row, alone or in a dictionary with a picture."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from bus.observations import (
    ALTITUDE,
    GRADIENT,
    UAV,
    UGV,
    Row,
    Table,
    bounds,
    names,
    team_table,
    ugv_table,
    without,
)
from sim.env.patch import check_tile_patch, given_patch
from sim.env.settings import Settings
from sim.env.spaces import box, extent_of
from sim.models.ground import OUTSIDE, TileArray, tile_patches
from sim.scenario.kinematics import steers
from sim.scenario.team import mates_of
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv

_X = names(UGV).index("x")

Array = npt.NDArray[Any]
AgentObservation = Array | dict[str, Array]
"""A row, or a dictionary of `row` and `coverage` or `tiles`; in a batch, every array has leading axes for worlds."""


def one_of_world(seen: AgentObservation, k: int) -> AgentObservation:
    """Return the observation in world k of a batch, as views."""
    return {key: array[k] for key, array in seen.items()} if isinstance(seen, dict) else seen[k]


def uav_table(*, altitude: bool, gradient: bool, mates: int = 0, omit: Sequence[str] = ()) -> Table:
    """Return the entries of a UAV's row, in the order of `sim.env.rows.RowState.uav_rows`.

    Args:
        altitude: True for a UAV that has an altitude.
        gradient, omit: As in `sim.env.settings.Settings`.
        mates: UAVs of its team, itself included; 0: it has no team.
    """
    table = UAV + (ALTITUDE if altitude else ()) + (GRADIENT if gradient else ())
    return without(table, omit) + team_table(mates)


def uav_space(
    extent: dict[str, float],
    *,
    estimate: bool,
    gradient: bool,
    altitude: bool = False,
    mates: int = 0,
    omit: Sequence[str] = (),
    pixels: int,
    dtype: type[np.floating],
) -> spaces.Space[Any]:
    """Return the space of a UAV's observation in one world.

    Args:
        extent: Values of `bus.observations.SYMBOLS`.
        estimate, gradient, omit, dtype: As in `sim.env.settings.Settings`.
        altitude, mates: As in `uav_table`.
        pixels: Pixels per side of the picture of its map; 0: no picture.
    """
    table = uav_table(altitude=altitude, gradient=gradient, mates=mates, omit=omit)
    row = box(*bounds(table, extent | ({"d_max": extent["D"]} if estimate else {})), dtype)
    if not pixels:
        return row
    return spaces.Dict({"row": row, "coverage": spaces.Box(0.0, 1.0, (pixels, pixels), dtype)})


def _row_bounds(space: spaces.Space[Any]) -> tuple[Array, Array]:
    box: Any = space["row"] if isinstance(space, spaces.Dict) else space
    return box.low, box.high


class ObservationFormat:
    """Form of all vehicles' observations in one environment: type, pictures and spaces.

    Args:
        scenario: Scenario of the environment.
        settings: Settings of the environment.

    Raises:
        ValueError: If `dtype`, `coverage_patch` or `tile_patch` is not allowed.
    """

    def __init__(self, scenario: Scenario, settings: Settings) -> None:
        settings.check_agents([vehicle.name for vehicle in scenario.vehicles])
        self._settings = {one.name: settings.of_agent(one.name) for one in scenario.vehicles}
        self._mates = {uav.name: len(mates_of(scenario, uav.name)) for uav in scenario.uav}
        self.pictured = {
            name for name, own in self._settings.items() if own.coverage_patch is not None
        }
        """Vehicles whose observation has a picture of the map, if they are UAVs."""
        self.estimated = {name for name, own in self._settings.items() if own.estimate}
        """Vehicles whose row has the estimate, if they are UAVs."""
        side = check_tile_patch(settings.tile_patch)
        self.tile_patch = side if scenario.has_ground else 0
        """Tiles per side of a UGV's picture of the ground; 0: no picture."""
        self._tile = float(scenario.ground.tile)
        self.spaces: dict[str, spaces.Space[Any]] = {
            vehicle.name: self._space(vehicle, extent_of(scenario, vehicle))
            for vehicle in scenario.vehicles
        }
        """Space of an observation in one world, by vehicle."""
        full = names(uav_table(altitude=True, gradient=True))
        self.columns = {
            uav.name: [full.index(name) for name in names(self._table(uav)) if name in full]
            for uav in scenario.uav
        }
        """Columns of each UAV's row in `sim.env.rows.RowState.uav_rows`; the entries of its team follow."""
        self.team_entries = {name: len(team_table(count)) for name, count in self._mates.items()}
        """Entries of each UAV's row about its team; 0: it has none."""
        self.ugv_entries = {ugv.name: len(ugv_table(steers=steers(ugv))) for ugv in scenario.ugv}
        """Entries of each UGV's row in `sim.env.rows.RowState.ugv_rows`."""
        self._bounds = {name: _row_bounds(space) for name, space in self.spaces.items()}

    def _table(self, uav: Uav) -> Table:
        return uav_table(
            altitude=uav.initial_altitude is not None,
            gradient=bool(self._settings[uav.name].gradient),
            mates=self._mates[uav.name],
            omit=tuple(self._settings[uav.name].omit),
        )

    def _space(self, vehicle: Uav | Ugv, extent: dict[str, float]) -> spaces.Space[Any]:
        own = self._settings[vehicle.name]
        dtype: Any = own.dtype
        if isinstance(vehicle, Ugv):
            table = ugv_table(steers=steers(vehicle))
            row, side = box(*bounds(table, extent), dtype), self.tile_patch
            tiles = spaces.Box(0, OUTSIDE, (side, side), np.uint8)
            return spaces.Dict({"row": row, "tiles": tiles}) if side else row
        patch = given_patch(own.coverage_patch)
        pixels = 0 if patch is None else patch.pixels
        altitude = vehicle.initial_altitude is not None
        return uav_space(
            extent,
            estimate=bool(own.estimate),
            gradient=bool(own.gradient),
            altitude=altitude,
            mates=self._mates[vehicle.name],
            omit=tuple(own.omit),
            pixels=pixels,
            dtype=dtype,
        )

    def shown(
        self, name: str, row: Row, *, coverage: Array | None = None, known: TileArray | None = None
    ) -> AgentObservation:
        """Return an observation in this form, clipped to its space: new arrays. Leading axes may be worlds.

        Args:
            name: Name of the vehicle.
            row: Row of the vehicle. Shape (..., entries).
            coverage: Picture of a UAV's map; None: no picture. Shape (..., pixels, pixels).
            known: Ground as known to a UGV; None: no picture. Shape (..., rows, columns).
        """
        dtype: Any = self._settings[name].dtype
        own = np.clip(row.astype(dtype), *self._bounds[name])
        if coverage is not None:
            return {"row": own, "coverage": coverage.astype(dtype)}
        return own if known is None else {"row": own, "tiles": self._tiles_around(row, known)}

    def _tiles_around(self, row: Row, known: TileArray) -> TileArray:
        side = self.tile_patch
        pictures: TileArray = np.empty((*row.shape[:-1], side, side), np.uint8)
        tile_patches(
            np.ascontiguousarray(known).reshape(-1, *known.shape[-2:]),
            self._tile,
            np.ascontiguousarray(row[..., _X : _X + 2], np.float64).reshape(-1, 2),
            pictures.reshape(-1, side, side),
        )
        return pictures
