"""The picture of one run."""

import math
import struct

import matplotlib as mpl
import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from bus.messages.scenario import Area, Law
from flights import escort, pairs
from outrider import style
from outrider.running.flying import fly
from outrider.view.flight_picture import SIZE, draw_flight, flight_figure
from sim.scenario.types import Detections
from sim.scenario.vehicle_types import Uav, Ugv
from sim.scene.drawing import Map
from sim.scene.known import geometry_of, scene_of
from sim.scene.model import Moment, observed_scene
from sim.server.flight import Flight

NOISY = Detections(noise=0.1, dropout=0.1)
LABELS = ["y [m]", "coverage C/C*", r"$\|p_\Delta\|$ [m]", "e(t) [m²]", "error [m]"]
GOALS = ((26.0, 20.0), (26.0, 26.0))


def scenario(law="logarithmic", *, uav=None, **fields):
    one = Uav(position=(20.0, 21.0), **(uav or {}))
    fields = {"name": "test", "duration": 10.0, "detections": NOISY, **fields}
    return escort(law, uav=one, ugv=Ugv(position=(20.0, 20.0), goals=GOALS), **fields)


@pytest.fixture(scope="module")
def flight():
    return fly(scenario(), 3)[0]


def png_size(path):
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


def panel(figure, title):
    return next(axes for axes in figure.axes if axes.get_title(loc="left").startswith(title))


def texts(artist):
    return [text.get_text() for text in artist.texts]


def test_picture_is_a_small_png_for_any_user_settings(flight, tmp_path):
    draw_flight(flight, tmp_path / "a.png")
    assert png_size(tmp_path / "a.png") == SIZE
    assert 20_000 < (tmp_path / "a.png").stat().st_size < 400_000
    with mpl.rc_context(
        {"font.size": 20.0, "axes.facecolor": "black", "savefig.dpi": 50, "text.usetex": False}
    ):
        before = dict(mpl.rcParams)
        draw_flight(flight, tmp_path / "b.png")
        assert dict(mpl.rcParams) == before
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_picture_shows_the_recorded_flight(flight):
    figure, (far, error) = flight_figure(flight), flight.recorder.escorts[:, 0, :2].T
    header = " ".join(texts(figure))
    for part in ("test", "law logarithmic", "seed 3", f"{far.max():.2f} m"):
        assert part in header
    assert f"margin {4.75 - far.max():.2f} m" in header
    shown = figure.axes[0].images[0].get_array()
    np.testing.assert_array_equal(shown, np.minimum(flight.world.coverage / 2.0, 1.0))
    for title, values in (("Distance", far), ("Coverage error", error)):
        line = panel(figure, title).lines[0]
        np.testing.assert_array_equal(line.get_ydata(), values)
        np.testing.assert_allclose(line.get_xdata(), np.arange(201) * 0.05)
    assert [axes.get_ylabel() for axes in figure.axes] == LABELS


@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_a_flight_cut_short_is_drawn(ticks, tmp_path):
    flown = Flight(scenario(), 0)
    flown.recorder.record(flown.answers.reports)
    if ticks:
        flown = fly(
            scenario(),
            0,
            on_tick=lambda flight: flight.stop() if flight.world.tick == ticks else None,
        )[0]
    assert flown.recorder.rows == ticks + 1
    draw_flight(flown, tmp_path / "flight.png")
    assert png_size(tmp_path / "flight.png") == SIZE


def test_empty_flight_or_missing_folder_raises(flight, tmp_path):
    with pytest.raises(ValueError, match="no recorded state"):
        draw_flight(Flight(scenario(), 0), tmp_path / "flight.png")
    assert not (tmp_path / "flight.png").exists()
    with pytest.raises(OSError, match="nowhere"):
        draw_flight(flight, tmp_path / "nowhere" / "flight.png")


def test_two_pairs_have_colors_and_names_of_their_own(tmp_path):
    places = ((9.0, 8.0), (30.0, 28.0))
    uavs = [{"escorts": f"ugv_{1 - k}", "position": place} for k, place in enumerate(places)]
    ugvs = ({"position": (30.0, 27.0), "goals": GOALS}, (8.0, 8.0))
    flown = fly(pairs(uavs, ugvs, name="pairs", duration=5.0, detections=NOISY), 1)[0]
    figure = flight_figure(flown)
    lines = panel(figure, "Distance").get_legend_handles_labels()
    assert lines[1] == ["uav_0", "uav_1"]
    assert len({line.get_color() for line in lines[0]}) == 2
    circles = [patch for patch in figure.axes[0].patches if patch.get_radius() == 4.75]
    assert sorted(tuple(circle.center) for circle in circles) == sorted(
        map(tuple, flown.recorder.states[-1, 2:, :2])
    )
    figure.draw_without_rendering()
    (title,) = (
        text for text in panel(figure, "Distance").findobj(Text) if "Dist" in text.get_text()
    )
    legend = panel(figure, "Distance").get_legend()
    assert not title.get_window_extent().overlaps(legend.get_window_extent())
    assert "pairs" in texts(figure)


def test_observers_have_the_same_scene_as_who_knows_the_scenario():
    one = scenario()
    names = [vehicle.name for vehicle in one.vehicles]
    geometry = geometry_of(one)
    observed = observed_scene(one.name, geometry, escorts=geometry.uavs, vehicles=names)
    assert observed == scene_of(one)
    assert observed.vehicles[0].goals


@pytest.mark.parametrize(
    ("driver", "shown"),
    [("waypoints", True), ("teleop", True), ("evade", False), ("wander", False)],
)
def test_goals_are_shown_where_the_driver_may_go_to_them(driver: str, shown: bool) -> None:
    one = scenario()
    ugv = msgspec.structs.replace(one.ugv[0], driver=driver)
    scene = scene_of(msgspec.structs.replace(one, ugv=(ugv,)))
    (goals,) = (vehicle.goals for vehicle in scene.vehicles if vehicle.name == ugv.name)
    assert goals == (ugv.goals if shown else ())


def narrow(width, height):
    place = {"position": (6.0, 6.0)}
    return msgspec.structs.replace(
        scenario(duration=1.0, area=Area(width=width, height=height, cell=0.5)),
        uav=(Uav(**place),),
        ugv=(Ugv(**place, goals=((8.0, 8.0),)),),
    )


@pytest.mark.parametrize(
    "odd",
    [
        scenario(detections=Detections(noise=0.1, dropout=1.0)),
        narrow(200.0, 12.0),
        narrow(12.0, 200.0),
        scenario(name="$x_{ $ " + "long " * 30, duration=0.5),
    ],
    ids=["a UGV that is never seen", "narrow", "low", "a name that is no formula"],
)
def test_unusual_scenario_is_drawn(odd, tmp_path):
    flown, summary = fly(odd, 0)
    assert (summary.detections == 0) is (odd.detections.dropout == 1.0)
    draw_flight(flown, tmp_path / "flight.png")
    assert png_size(tmp_path / "flight.png") == SIZE
    assert max(map(len, texts(flight_figure(flown)))) < 150


@pytest.mark.parametrize(
    ("uav", "drawn"),
    [
        ({}, True),
        ({"max_speed": math.inf, "max_acceleration": math.inf}, False),
        ({"max_speed": 3.0}, False),
    ],
    ids=["paper", "unbounded", "too fast to stop in time"],
)
def test_r_s_is_drawn_only_as_a_separate_circle(uav, drawn):
    law = Law(name="coverage", parameters={"reference_speed": 0.6})
    one = msgspec.structs.replace(scenario(uav=uav, duration=1.0), law=law)
    figure = flight_figure(fly(one, 0)[0])
    assert ("$r_s$" in texts(panel(figure, "Distance"))) is drawn
    assert "$r_v$" in texts(panel(figure, "Distance"))
    radii = sorted({round(patch.get_radius(), 3) for patch in figure.axes[0].patches})
    assert radii == ([3.683, 4.75, 5.0] if drawn else [4.75, 5.0])


@pytest.mark.parametrize(("r_v", "r_s"), [(4.75, 3.65), (3.0, 3.65), (4.75, 4.7), (4.75, None)])
def test_names_of_close_radii_do_not_overlap(r_v, r_s):
    figure = style.new_figure(1400, 400)
    axes = figure.add_subplot()
    axes.set_ylim(0.0, 40.0)
    style.limits_of_sight(axes, r_v, r_s)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in axes.texts]
    assert len(boxes) == (1 if r_s is None else 2)
    assert not any(a.overlaps(b) for a in boxes for b in boxes if a is not b)


def test_each_of_eight_uavs_has_its_own_line():
    places = [(4.0 + 4.0 * k, 20.0) for k in range(8)]
    flown = fly(pairs(places, places, name="eight", duration=0.5), 1)[0]
    drawn = [
        line for line in panel(flight_figure(flown), "Distance").lines
        if line.get_label().startswith("uav_")
    ]  # fmt: skip
    assert len(drawn) == 8
    assert len({(line.get_color(), line.get_linestyle()) for line in drawn}) == 8
    assert {line.get_color() for line in drawn} == set(style.UAV)


def test_a_nearly_constant_curve_lies_within_its_chart():
    figure = flight_figure(fly(scenario(duration=0.1), 0)[0])
    axes = panel(figure, "Coverage error")
    assert axes.get_ylim()[1] > 1.05 * max(axes.lines[0].get_ydata())


def test_only_lost_sight_is_shaded_and_stated(flight):
    def shaded(figure):
        return [one for one in panel(figure, "Distance").collections[0].get_paths() if len(one)]

    assert not shaded(flight_figure(flight))
    flown, summary = fly(scenario("coverage", duration=60.0, detections=Detections()), 0)
    assert summary.visibility_violations > 0
    figure = flight_figure(flown)
    lost = np.flatnonzero(flown.recorder.escorts[:, 0, 0] >= 4.75) * 0.05
    first = min(path.get_extents().x0 for path in shaded(figure))
    assert first == pytest.approx(lost[0], abs=0.051)
    assert f"UGV out of sight for {summary.visibility_violations * 0.05:.2f} s" in texts(figure)
    # without noise there is no panel for it
    assert [axes.get_ylabel() for axes in figure.axes] == LABELS[:-1]


@pytest.mark.parametrize(("heading", "ahead"), [(0.0, (12, 0)), (0.5 * math.pi, (0, 12))])
def test_a_ugv_that_steers_is_drawn_with_a_tip_at_its_heading(
    heading: float, ahead: tuple[int, int]
) -> None:
    """The UGV's color reaches this many pixels farther ahead than behind."""
    figure = Figure(figsize=(4.0, 4.0), dpi=400)
    canvas = FigureCanvasAgg(figure)
    scene = observed_scene("", None, escorts={}, vehicles=["ugv_0"], ground=(10.0, 10.0))
    drawn = Map(figure.add_axes((0.0, 0.0, 1.0, 1.0)), scene)
    drawn.show({"ugv_0": np.array([[5.0, 5.0]])}, moment=Moment(headings={"ugv_0": heading}))
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[:, :, :3].astype(int)
    rows, columns = np.nonzero(np.abs(picture - (232, 116, 12)).max(axis=2) < 60)
    extent = columns.max() + columns.min() - 1599, 1599 - rows.max() - rows.min()
    assert extent == pytest.approx(ahead, abs=6)
