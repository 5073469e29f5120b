"""The picture of one flight: where everybody went, what was seen of the ground, and whether the UGV stayed in sight."""

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D

from outrider import style
from outrider.running.summary import switching_radius_of
from sim.kernels.compile import FloatArray
from sim.scenario.types import Ugv
from sim.server.flight import Flight

SIZE = (1400, 800)
"""Of the picture [px]."""


def draw_flight(flight: Flight, path: Path) -> None:
    """Draw a flight into a PNG file.

    Args:
        flight: Flown to its end or cut short; at least one state must have been taken down.
        path: The file; its folder must be there.

    Raises:
        OSError: If the file cannot be written.
        ValueError: If no state has been taken down.
    """
    with style.look():
        style.save(flight_figure(flight), path)


def flight_figure(flight: Flight) -> Figure:
    """The same picture as a figure, for those who draw it themselves.

    Raises:
        ValueError: If no state has been taken down.
    """
    if flight.recorder.rows == 0:
        raise ValueError("no state has been taken down: there is nothing to draw")
    with style.look():
        figure = style.new_figure(*SIZE, header=0.1)
        noisy = flight.scenario.detections.noise > 0.0
        panels = (
            (_draw_distance, _draw_error, _draw_estimate)
            if noisy
            else (_draw_distance, _draw_error)
        )
        grid = figure.add_gridspec(
            len(panels), 2, width_ratios=(1.2, 1.0), height_ratios=(1.35, 1.0, 0.8)[: len(panels)]
        )
        _draw_map(figure, figure.add_subplot(grid[:, 0]), flight)
        for k, draw in enumerate(panels):
            axes = figure.add_subplot(grid[k, 1])
            draw(axes, flight)
            if k < len(panels) - 1:  # they share their time axis
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        _draw_header(figure, flight)
    return figure


def times(flight: Flight) -> FloatArray:
    """The time of each row of the record [s]."""
    found: FloatArray = np.arange(flight.recorder.rows, dtype=np.float64) * flight.scenario.dt
    return found


def _end(flight: Flight) -> float:
    return max(flight.recorder.rows - 1, 1) * flight.scenario.dt


def ugv_color(flight: Flight, name: str) -> str:
    """The orange of a UGV."""
    names = [vehicle.name for vehicle in flight.scenario.vehicles if isinstance(vehicle, Ugv)]
    return style.color(style.UGV, names.index(name))


def draw_ground(axes: Axes, flight: Flight) -> AxesImage:
    """Q with what was seen of it, as a share of the coverage wanted."""
    area = flight.scenario.area
    style.ground(axes, area.width, area.height)
    share = np.minimum(flight.world.coverage / flight.scenario.coverage.desired, 1.0)
    return axes.imshow(
        share,
        cmap=style.COVERED,
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=(0.0, area.width, 0.0, area.height),
    )


def draw_track(
    axes: Axes,
    track: FloatArray,
    color: str,
    *,
    marker: str,
    width: float = 1.6,
    line: str = "-",
    label: str = "",
) -> None:
    """The way of one vehicle, with a hollow mark where it started and a full one where it is."""
    axes.plot(track[:, 0], track[:, 1], line, color=color, linewidth=width, label=label, zorder=4)
    axes.plot(
        *track[0],
        marker,
        markersize=6,
        color="white",
        markeredgecolor=color,
        markeredgewidth=1.5,
        zorder=6,
    )
    axes.plot(
        *track[-1],
        marker,
        markersize=8,
        color=color,
        markeredgecolor="white",
        markeredgewidth=1.2,
        zorder=7,
    )


def draw_vehicles(axes: Axes, flight: Flight) -> None:
    """Tracks of all vehicles and the goals of the UGVs."""
    states = flight.recorder.states
    row = {name: k for k, name in enumerate(flight.world.names)}
    for vehicle in flight.scenario.vehicles:
        if isinstance(vehicle, Ugv):
            color = ugv_color(flight, vehicle.name)
            for goal in vehicle.goals:
                axes.plot(
                    *goal, marker="x", markersize=6, markeredgewidth=1.8, color=color, zorder=3.5
                )
            draw_track(axes, states[:, row[vehicle.name], :2], color, marker="s", width=2.2)
    for k, uav in enumerate(flight.world.uavs):
        draw_track(axes, states[:, row[uav.name], :2], style.color(style.UAV, k), marker="o")


def _inner_radius(flight: Flight, escort: int) -> float | None:
    """r_s [m] where it is a circle of its own."""
    r_s = switching_radius_of(flight, escort)
    return r_s if r_s is not None and 0.0 < r_s < flight.scenario.visibility.radius else None


def _draw_rings(axes: Axes, flight: Flight) -> None:
    """Sight around each UGV, and how far each UAV's sensor reaches, at the end."""
    for k, (a, g) in enumerate(flight.world.escorts.tolist()):
        p_a, p_g = flight.recorder.states[-1, a, :2], flight.recorder.states[-1, g, :2]
        style.ring(axes, (p_g[0], p_g[1]), flight.scenario.visibility.radius)
        r_s = _inner_radius(flight, k)
        if r_s is not None:
            style.ring(axes, (p_g[0], p_g[1]), r_s, dashed=True, width=1.2)
        style.ring(
            axes,
            (p_a[0], p_a[1]),
            flight.scenario.sensor.range,
            color=style.color(style.UAV, k),
            width=0.8,
        )


def _map_legend(flight: Flight) -> list[Line2D]:
    entries = style.vehicle_keys(len(flight.world.uavs), len(flight.scenario.ugv))
    entries.append(style.key(style.LIMIT, "limit of sight $r_v$"))
    if _inner_radius(flight, 0) is not None:
        entries.append(
            style.key(style.LIMIT, "only tracking, $r_s$", linestyle=(0, (3, 1.6)), linewidth=1.2)
        )
    return [*entries, style.key(style.UAV[0], "range of the sensor", linewidth=0.8)]


def _draw_map(figure: Figure, axes: Axes, flight: Flight) -> None:
    image = draw_ground(axes, flight)
    draw_vehicles(axes, flight)
    _draw_rings(axes, flight)
    axes.legend(
        handles=_map_legend(flight),
        loc="upper center",
        bbox_to_anchor=(0.5, -0.08),
        ncols=3,
        columnspacing=1.6,
    )
    style.coverage_bar(figure, image, axes)


def shade_violations(axes: Axes, time: FloatArray, distance: FloatArray, r_v: float) -> None:
    """A red veil over the times at which the UGV is out of sight (5)."""
    top = axes.get_ylim()[1]
    axes.fill_between(
        time,
        0.0,
        top,
        where=(distance >= r_v).tolist(),
        color=style.LIMIT,
        alpha=0.12,
        linewidth=0.0,
        step="post",
    )
    axes.set_ylim(0.0, top)


def _draw_distance(axes: Axes, flight: Flight) -> None:
    time, distance = times(flight), flight.recorder.escorts[:, :, 0]
    r_v = flight.scenario.visibility.radius
    for k, uav in enumerate(flight.world.uavs):
        axes.plot(time, distance[:, k], color=style.color(style.UAV, k), label=uav.name)
    style.over_time(axes, _end(flight), r"$\|p_\Delta\|$ [m]")
    axes.set_ylim(0.0, 1.12 * max(r_v, float(distance.max())))
    style.limits_of_sight(axes, r_v, _inner_radius(flight, 0))
    shade_violations(axes, time, distance.max(axis=1), r_v)
    axes.set_title("Distance between UAV and UGV")
    if distance.shape[1] > 1:
        style.legend_above(axes)


def _draw_error(axes: Axes, flight: Flight) -> None:
    error = flight.recorder.escorts[:, :, 1]
    for k in range(error.shape[1]):
        axes.plot(times(flight), error[:, k], color=style.color(style.UAV, k))
    style.over_time(axes, _end(flight), "e(t) [m²]")
    axes.set_title("Ground around the UGV not yet seen")


def _draw_estimate(axes: Axes, flight: Flight) -> None:
    """How far off the detections are, and what the filter makes of them."""
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
            label="filter" if k == 0 else "",
        )
    style.over_time(axes, _end(flight), "error [m]")
    axes.set_title("Estimate of the UGV's place")
    style.legend_above(axes)


def _draw_header(figure: Figure, flight: Flight) -> None:
    scenario, distance = flight.scenario, flight.recorder.escorts[:, :, 0]
    r_v, farthest = scenario.visibility.radius, float(distance.max())
    lost = int((distance >= r_v).any(axis=1).sum())
    verdict, color = f"UGV in sight all the time, margin {r_v - farthest:.2f} m", style.GOOD
    if lost:
        verdict, color = f"UGV out of sight for {lost * scenario.dt:.2f} s", style.LIMIT
    facts = (
        f"law {scenario.law.name}   ·   seed {flight.seed}   ·   {flight.recorder.ticks * scenario.dt:g} s   ·   "
        f"largest distance {farthest:.2f} m of $r_v$ = {r_v:g} m"
    )
    name = textwrap.shorten(scenario.name, 48) or "scenario"
    figure.text(0.014, 0.968, name, fontsize=15, fontweight="bold", va="top", parse_math=False)
    figure.text(0.014, 0.908, facts, color=style.MUTED, va="top")
    figure.text(
        0.986, 0.962, verdict, fontsize=11, fontweight="bold", color=color, va="top", ha="right"
    )
