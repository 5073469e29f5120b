"""Picture of one flight: tracks, coverage, distance over time, and a verdict on visibility."""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.transforms import offset_copy

from bus.errors import shortened
from bus.messages.ground import GroundMap
from outrider import style
from sim.compiling.compile import FloatArray, IntArray
from sim.scene.altitude import HIDDEN, sight_at
from sim.scene.drawing import Map, legend_of
from sim.scene.ground_map import HIT, ground_map
from sim.scene.known import inner_radius, scene_of
from sim.scene.model import Moment, Scene
from sim.scene.team import LOOKS, dashes_of, in_role, known_roles, occurring
from sim.server.flight import Flight

_RATIOS = (1.35, 1.0, 0.8, 0.8)
"""Heights of the charts beside the map, relative to each other."""
SIZE = (1400, 800)
"""Size of the picture [px]."""
_LEGEND_OF_GROUND = 60
"""Additional height for the legend of hazards [px]."""
_LEGEND_OF_TEAM = 40
"""Additional height for the legend of roles [px]."""
_ALTITUDE = 130
"""Additional height for the chart of the altitude [px]."""


def draw_flight(flight: Flight, path: Path, hazards: GroundMap | None = None) -> None:
    """Draw a flight into a PNG file.

    Args:
        flight: Complete or interrupted flight with at least one recorded state.
        path: File to write; its folder must exist.
        hazards: Ground map at the flight's end; None: from the flight's world.

    Raises:
        OSError: If the file cannot be written.
        ValueError: If the flight has no recorded state.
    """
    with style.plot_style():
        style.save(flight_figure(flight, hazards), path)


def flight_figure(flight: Flight, hazards: GroundMap | None = None) -> Figure:
    """Return the picture of `draw_flight` as a figure.

    Raises:
        ValueError: If the flight has no recorded state.
    """
    if flight.recorder.rows == 0:
        raise ValueError("flight: no recorded state; allowed: a flight with one state or more")
    with style.plot_style():
        if hazards is None:
            hazards = ground_map(flight.world, routes=flight.routes)
        width, height = SIZE
        if hazards is not None:
            height += _LEGEND_OF_GROUND
        if flight.recorder.roles.any():
            height += _LEGEND_OF_TEAM
        panels = _panels(flight)
        height += _ALTITUDE if _draw_altitude in panels else 0
        figure = style.new_figure(width, height, header=0.1)
        grid = figure.add_gridspec(
            len(panels), 2, width_ratios=(1.2, 1.0), height_ratios=_RATIOS[: len(panels)]
        )
        _draw_map(figure, figure.add_subplot(grid[:, 0]), flight, hazards)
        for k, draw in enumerate(panels):
            axes = figure.add_subplot(grid[k, 1])
            draw(axes, flight)
            if k < len(panels) - 1:  # the panels share their time axis
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        _draw_header(figure, flight, hazards)
    return figure


def _panels(flight: Flight) -> tuple[Callable[[Axes, Flight], None], ...]:
    """Return the functions that draw the charts beside the map."""
    if not flight.world.uavs:
        return (_draw_speed,)
    panels: tuple[Callable[[Axes, Flight], None], ...] = (_draw_distance, _draw_error)
    if flight.scenario.detections.noise > 0.0:
        panels += (_draw_estimate,)
    return (*panels, _draw_altitude) if flight.scenario.has_altitude else panels


def times(flight: Flight) -> FloatArray:
    """Return the simulated time of each row of the record [s]."""
    found: FloatArray = np.arange(flight.recorder.rows, dtype=np.float64) * flight.scenario.dt
    return found


def _end(flight: Flight) -> float:
    return max(flight.recorder.rows - 1, 1) * flight.scenario.dt


def draw_map(
    axes: Axes, flight: Flight, scene: Scene, hazards: GroundMap | None = None
) -> AxesImage:
    """Draw the end of a flight from above, with the tracks; return the image of the ground.

    Args:
        axes: Axes to draw on.
        flight: Flight with its record.
        scene: Scene of its scenario, with the circles to draw.
        hazards: Ground map with hazards; None: no hazards.
    """
    states, heights = flight.recorder.states, flight.recorder.heights[-1]
    drawn = Map(axes, scene, hazards=hazards)
    drawn.show(
        {name: states[:, k, :2] for k, name in enumerate(flight.world.names)},
        np.minimum(flight.world.coverage / flight.scenario.coverage.desired, 1.0),
        moment=Moment(
            altitudes=dict(zip(_names(flight), heights[:, 0].tolist(), strict=False)),
            headings=flight.world.headings(),
            hidden={
                name for name, row in zip(_names(flight), heights, strict=False) if row[3] == 0.0
            },
        ),
        roles=_roles(flight),
    )
    return drawn.image


def _draw_map(figure: Figure, axes: Axes, flight: Flight, hazards: GroundMap | None) -> None:
    scene = scene_of(flight.scenario, flight.world.buildings)
    image = draw_map(axes, flight, scene, hazards)
    if hazards is not None:  # the legend is too long for the space below the map
        keys = legend_of(scene, hazards=hazards, roles=occurring(_roles(flight)))
        figure.legend(handles=keys, loc="outside lower left", ncols=6, columnspacing=1.6)
    else:
        axes.legend(
            handles=legend_of(scene, roles=occurring(_roles(flight))),
            loc="upper center",
            bbox_to_anchor=(0.5, 0.0),
            bbox_transform=offset_copy(axes.transAxes, figure, y=-30.0, units="points"),
            ncols=3,
            columnspacing=1.6,
        )
    if flight.world.uavs:
        style.coverage_bar(figure, image, axes)


def _names(flight: Flight) -> tuple[str, ...]:
    return tuple(uav.name for uav in flight.world.uavs)


def _roles(flight: Flight) -> dict[str, IntArray]:
    """Return the role codes over time of each UAV in a team. Shape (rows,)."""
    return dict(zip(_names(flight), flight.recorder.roles.T, strict=False))


def _plot(axes: Axes, flight: Flight, values: FloatArray, *, label: bool = False) -> None:
    """Draw values of each UAV over time, in a team in the look of its role. Shape (rows, UAVs)."""
    time, roles = times(flight), _roles(flight)
    for k, name in enumerate(_names(flight)):
        named = name if label else ""
        if name not in roles or not roles[name].any():
            axes.plot(time, values[:, k], **style.line(k), label=named)
            continue
        known = known_roles(roles[name])
        axes.plot([], [], **style.line(k), label=named)
        for role in occurring({name: known}):
            look = LOOKS[role]
            line = style.line(k) | {"linestyle": dashes_of(look), "alpha": look.opacity}
            axes.plot(time, in_role(values[:, k], known, role), **line, linewidth=1.5 * look.width)


def _shade_violations(axes: Axes, flight: Flight) -> None:
    """Shade the times at which the UGV is out of sight, eq. (5)."""
    top = axes.get_ylim()[1]
    axes.fill_between(
        times(flight),
        0.0,
        top,
        where=flight.recorder.unseen.any(axis=1).tolist(),
        color=style.LIMIT,
        alpha=0.12,
        linewidth=0.0,
        step="post",
    )
    axes.set_ylim(0.0, top)


def _draw_distance(axes: Axes, flight: Flight) -> None:
    distance, r_v = flight.recorder.escorts[:, :, 0], flight.scenario.visibility.radius
    _plot(axes, flight, distance, label=True)
    style.over_time(axes, _end(flight), r"$\|p_\Delta\|$ [m]")
    axes.set_ylim(0.0, 1.12 * max(r_v, float(distance.max())))
    r_s = inner_radius(flight.scenario, flight.world.uavs[0].escorts)
    if flight.scenario.has_altitude:
        _draw_radii(axes, flight, r_s)
    else:
        style.limits_of_sight(axes, r_v, r_s)
    _shade_violations(axes, flight)
    axes.set_title("Distance between UAV and UGV")
    if distance.shape[1] > 1:
        style.legend_above(axes)


def _radii(flight: Flight) -> FloatArray:
    """Return the visibility radius of each UAV at its altitude [m]. Shape (rows, UAVs)."""
    scenario = flight.scenario
    space, r_v = scene_of(scenario).space, scenario.visibility.radius
    columns = [
        [sight_at(space, uav.escorts, r_v, z) for z in flight.recorder.heights[:, k, 0].tolist()]
        for k, uav in enumerate(flight.world.uavs)
    ]
    found: FloatArray = np.array(columns).T
    return found


def _draw_radii(axes: Axes, flight: Flight, r_s: float | None) -> None:
    """Draw the visibility radius over time, as it depends on the altitude, and r_s [m]."""
    radii = _radii(flight)
    for k in range(radii.shape[1]):
        axes.plot(times(flight), radii[:, k], color=style.LIMIT, linewidth=1.3, zorder=1.5)
    if r_s is not None:
        axes.axhline(r_s, color=style.LIMIT, linewidth=1.3, linestyle=style.DASHED, zorder=1.5)
    style.name_limits(axes, float(radii[-1, 0]), r_s, outer="$r_v(z)$")


def _draw_altitude(axes: Axes, flight: Flight) -> None:
    """Draw the altitudes, and the roof of the highest building."""
    altitudes, buildings = flight.recorder.heights[:, :, 0], flight.world.buildings
    for k, name in enumerate(_names(flight)):
        axes.plot(times(flight), altitudes[:, k], **style.line(k), label=name)
    style.over_time(axes, _end(flight), "z [m]")
    axes.set_ylim(0.0, 1.15 * float(altitudes.max()))
    axes.set_title("Altitude of the UAV" if altitudes.shape[1] == 1 else "Altitude of the UAVs")
    if not buildings:
        return
    highest = max(building.height for building in buildings)
    axes.axhline(highest, color=style.MUTED, linewidth=1.2, linestyle=style.DASHED, zorder=1.5)
    below = highest > 0.4 * axes.get_ylim()[1]  # away from the altitudes
    axes.annotate(
        f"highest building, {highest:.1f} m",
        (0.01, highest),
        xytext=(0.0, -2.0 if below else 1.0),
        xycoords=axes.get_yaxis_transform(),
        textcoords="offset points",
        color=style.MUTED,
        fontsize=8.0,
        va="top" if below else "bottom",
    )


def _draw_error(axes: Axes, flight: Flight) -> None:
    _plot(axes, flight, flight.recorder.escorts[:, :, 1])
    style.over_time(axes, _end(flight), "e(t) [m²]")
    axes.set_title("Coverage error around the UGV")


def _draw_estimate(axes: Axes, flight: Flight) -> None:
    """Draw the errors of the detections and of the estimates."""
    states, escorts, time = flight.recorder.states, flight.recorder.escorts, times(flight)
    for k, (a, g) in enumerate(flight.world.escorts.tolist()):
        p_a, p_g = states[:, a, :2], states[:, g, :2]
        detected = np.linalg.norm(escorts[:, k, 2:4] - (p_a - p_g), axis=1)
        estimated = np.linalg.norm(escorts[:, k, 4:6] - p_g, axis=1)
        axes.plot(
            time,
            detected,
            ".",
            color="#b4bac4",
            markersize=1.6,
            label="detection" if k == 0 else "",
        )
        axes.plot(
            time,
            estimated,
            color=style.color(style.UAV, k),
            linewidth=1.2,
            label="estimate" if k == 0 and not np.isnan(estimated).all() else "",
        )
    style.over_time(axes, _end(flight), "error [m]")
    axes.set_title("Estimate of the UGV's position")
    style.legend_above(axes)


def _draw_speed(axes: Axes, flight: Flight) -> None:
    """Draw the speeds of UGVs without escort."""
    for k, name in enumerate(flight.world.names):
        speed = np.hypot(flight.recorder.states[:, k, 2], flight.recorder.states[:, k, 3])
        axes.plot(times(flight), speed, color=style.color(style.UGV, k), label=name)
    style.over_time(axes, _end(flight), "v [m/s]")
    axes.set_ylim(bottom=0.0)
    axes.set_title("Speed of the UGV" if len(flight.world.names) == 1 else "Speed of the UGVs")
    if len(flight.world.names) > 1:
        style.legend_above(axes)


_LEVEL = 0.05
"""Largest change of an altitude that counts as level flight [m]."""


class _Verdict(NamedTuple):
    """Verdict on visibility, for the header."""

    text: str
    color: str
    reached: str
    """Text with the largest distance."""


def _verdict(flight: Flight) -> _Verdict | None:
    """Return the verdict on visibility; None without a UAV."""
    recorder = flight.recorder
    if not recorder.escorts.size:
        return None
    r_v, farthest = flight.scenario.visibility.radius, float(recorder.nearest.max())
    whose = "largest distance" if flight.scenario.team is None else "nearest UAV within"
    reached, margin = f"{whose} {farthest:.2f} m", float(recorder.widest_margins.min())
    heights = recorder.heights
    if flight.scenario.has_altitude:
        lowest, highest = float(heights[:, :, 0].min()), float(heights[:, :, 0].max())
        span = "" if highest - lowest < _LEVEL else f"{lowest:.1f} to "
        reached += f"   ·   altitude {span}{highest:.1f} m"
    else:
        reached += f" of $r_v$ = {r_v:g} m"
    dt, lost = flight.scenario.dt, int(recorder.unseen.any(axis=1).sum())
    if not lost:
        return _Verdict(f"UGV always in sight, margin {margin:.2f} m", style.GOOD, reached)
    hidden = int((heights[:, :, 3] == 0.0).any(axis=1).sum()) if heights.shape[1] else 0
    behind = f", of which {hidden * dt:.2f} s {HIDDEN}" if hidden else ""
    return _Verdict(f"UGV out of sight for {lost * dt:.2f} s{behind}", style.LIMIT, reached)


def _draw_header(figure: Figure, flight: Flight, hazards: GroundMap | None) -> None:
    scenario, verdict = flight.scenario, _verdict(flight)
    named = f"{style.plain(shortened(scenario.name, 24))}   ·   " if scenario.title else ""
    facts = [
        flight.law_name if verdict is None else f"law {flight.law_name}",
        f"seed {flight.seed}",
    ]
    facts.append(f"{flight.recorder.ticks * scenario.dt:g} s")
    if verdict is not None:
        facts.append(verdict.reached)
    title = textwrap.shorten(scenario.title or scenario.name, 50, placeholder=" …") or "scenario"
    style.heading(figure, title, 0.968, 15.0, math=False)
    subtitle = named + "   ·   ".join(facts)
    figure.text(0.012, 0.908, subtitle, color=style.MUTED, va="top")
    if verdict is not None:
        figure.text(
            0.986,
            0.962,
            verdict.text,
            fontsize=11,
            fontweight="bold",
            color=verdict.color,
            va="top",
            ha="right",
        )
    mission = flight.world.mission
    if hazards is not None and mission is not None:
        hits = hazards.states.count(HIT)
        result = "no hazard hit" if not hits else f"{hits} hazard{'s' if hits > 1 else ''} hit"
        if mission.mission_time is not None:
            result += f", at the goals after {mission.mission_time:.1f} s"
        color = style.LIMIT if hits else style.MUTED
        figure.text(0.986, 0.908, result, color=color, va="top", ha="right")
