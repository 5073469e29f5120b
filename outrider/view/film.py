"""Pictures and films of a recording: the flight's picture as PNG, and the flight seen from above as GIF or MP4."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from PIL import Image

from bus.errors import ScenarioError
from outrider import style
from outrider.recording.reader import Recording, coverages
from outrider.recording.refly import from_the_start, restore
from outrider.recording.schemas import inner_radius
from sim.kernels.compile import FloatArray
from sim.scenario.types import Scenario

WIDTH = 800
"""Of a film [px]."""
_HEADER, _FOOTER, _SIDE = 92, 96, 68
"""Room above, below and beside the ground [px]."""
_TALLEST = 1000
"""Of the ground [px]."""
ENDINGS = (".png", ".gif", ".mp4")

Progress = Callable[[int, int], None]
"""Told how many frames of how many are drawn."""


def check_output(out: Path) -> None:
    """Refuse what cannot be drawn before any work is done.

    Raises:
        ScenarioError: If the ending is not a known one, or ffmpeg is needed and not there.
    """
    if out.suffix.lower() not in ENDINGS:
        raise ScenarioError(f"{out}: ending {out.suffix!r}; allowed: {', '.join(ENDINGS)}")
    if out.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise ScenarioError(
            f"{out}: MP4 needs the program ffmpeg, which is not on the PATH; allowed without it: .gif, .png"
        )


def render(
    recording: Recording,
    out: Path,
    *,
    fps: int = 20,
    speed: float = 10.0,
    on_frame: Progress = lambda _done, _all: None,
) -> None:
    """Draw a recorded flight.

    Args:
        recording: Must have a truth.
        out: What is drawn depends on its ending: the flight's picture, or a film.
        fps: Frames per second of a film.
        speed: Simulated seconds per second of a film.
        on_frame: Told how far it is.

    Raises:
        ScenarioError: If it cannot be drawn.
        OSError: If the file cannot be written.
    """
    check_output(out)
    ending = out.suffix.lower()
    if ending == ".png" and recording.head.scenario is not None and from_the_start(recording):
        from outrider.view.flight_picture import draw_flight  # noqa: PLC0415 - needed for a picture alone

        draw_flight(restore(recording), out)
        on_frame(1, 1)
        return
    with style.look():
        film = Film(recording)
        times = film.times if ending == ".png" else film.frame_times(speed / fps)
        shown = [times[-1]] if ending == ".png" else times
        frames = _counted(film.frames(shown), len(shown), on_frame)
        if ending == ".png":
            Image.fromarray(next(frames)).convert("RGB").save(out, format="PNG")
        elif ending == ".gif":
            _write_gif(frames, out, fps)
        else:
            _write_mp4(frames, out, fps)


def _counted(
    frames: "Iterator[np.ndarray[Any, Any]]", total: int, on_frame: Progress
) -> "Iterator[np.ndarray[Any, Any]]":
    for done, frame in enumerate(frames, 1):
        yield frame
        on_frame(done, total)


def _palette() -> Image.Image:
    """The colours of a GIF: shades of what is drawn on ground seen and unseen.

    The same for all frames, so nothing flickers.
    """
    ramp = [style.COVERED(k / 63.0)[:3] for k in range(64)]
    colors = [(1.0, 1.0, 1.0), *ramp]
    for ink in (style.LIMIT, style.UAV[0], style.UGV[0], style.INK, style.MUTED):
        for paper in ("#ffffff", "#d9e8de", "#86bb9f"):
            a, b = np.array(to_rgb(ink)), np.array(to_rgb(paper))
            colors += [tuple(a * share + b * (1.0 - share)) for share in np.linspace(0.12, 1.0, 12)]
    image = Image.new("P", (1, 1))
    image.putpalette([round(255.0 * part) for color in colors[:256] for part in color])
    return image


def _write_gif(frames: "Iterator[np.ndarray[Any, Any]]", out: Path, fps: int) -> None:
    palette = _palette()

    def reduced() -> Iterator[Image.Image]:
        for frame in frames:
            yield (
                Image.fromarray(frame)
                .convert("RGB")
                .quantize(palette=palette, dither=Image.Dither.NONE)
            )

    pictures = reduced()
    first = next(pictures)
    held = round(1000.0 / fps)
    with out.open("wb") as file:
        first.save(
            file,
            format="GIF",
            save_all=True,
            append_images=pictures,
            duration=held,
            loop=0,
            optimize=False,
        )


def _write_mp4(frames: "Iterator[np.ndarray[Any, Any]]", out: Path, fps: int) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    raw = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgba",
        "-s",
        f"{width}x{height}",
        "-r",
        str(fps),
        "-i",
        "-",
    ]
    coded = ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(out)]
    program = shutil.which("ffmpeg") or "ffmpeg"
    with subprocess.Popen(
        [program, "-y", "-loglevel", "error", *raw, *coded],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as ffmpeg:
        stdin, stderr = ffmpeg.stdin, ffmpeg.stderr
        if stdin is None or stderr is None:
            raise OSError(0, "no pipe to ffmpeg", str(out))
        try:
            for frame in chain((first,), frames):
                stdin.write(frame.tobytes())
            stdin.close()
        except BrokenPipeError:
            pass  # it says why
        words = stderr.read().decode(errors="replace")
    if ffmpeg.returncode:
        raise OSError(0, f"ffmpeg: {' '.join(words.split()) or ffmpeg.returncode}", str(out))


class Film:
    """One flight from above, frame by frame.

    Args:
        recording: Must have a truth.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._scenario: Scenario | None = (
            recording.scenario if recording.head.scenario is not None else None
        )
        truths = recording.truths
        self.times: FloatArray = np.array([truth.time for truth in truths])
        """Of the recorded ticks [s]."""
        self._escorts = {escort.uav: escort.ugv for escort in truths[0].escorts}
        self._uavs = sorted(self._escorts)
        self._ugvs = sorted(set(truths[0].vehicles) - set(self._uavs))
        self._tracks = {
            name: np.array([truth.vehicles[name].position for truth in truths])
            for name in (*self._uavs, *self._ugvs)
        }
        self._maps = coverages(recording.path, flight=recording.number)
        self._waiting = next(self._maps, None)
        self._build()

    def frame_times(self, step: float) -> FloatArray:
        """Simulated times [s], `step` apart, the flight's end included."""
        found: FloatArray = np.append(
            np.arange(self.times[0], self.times[-1], step), self.times[-1]
        )
        return found

    def _area(self) -> tuple[float, float]:
        """Width and height of the ground [m]."""
        if self._scenario is not None:
            return self._scenario.area.width, self._scenario.area.height
        if self._waiting is not None:
            return (
                self._waiting.columns * self._waiting.cell,
                self._waiting.rows * self._waiting.cell,
            )
        highest = np.concatenate(list(self._tracks.values())).max(axis=0)
        return float(highest[0]) + 5.0, float(highest[1]) + 5.0

    def _build(self) -> None:
        width, height = self._area()
        scale = min((WIDTH - 2 * _SIDE) / width, _TALLEST / height)
        across, tall = width * scale, height * scale
        total = round(tall + _HEADER + _FOOTER) // 2 * 2  # video wants even numbers
        self._figure = style.new_figure(WIDTH, total)
        self._figure.set_layout_engine("none")
        self._canvas = FigureCanvasAgg(self._figure)
        axes = self._axes = self._figure.add_axes(
            ((WIDTH - across) / 2 / WIDTH, _FOOTER / total, across / WIDTH, tall / total), zorder=1
        )
        style.ground(axes, width, height)
        self._ground = axes.imshow(
            np.zeros((1, 1)),
            cmap=style.COVERED,
            vmin=0.0,
            vmax=255.0,
            origin="lower",
            extent=(0.0, width, 0.0, height),
        )
        self._artists: list[Artist] = [self._ground]
        self._draw_goals()
        self._lines, self._bodies = dict[str, Line2D](), dict[str, Line2D]()
        for names, colors, marker, thick in (
            (self._ugvs, style.UGV, "s", 2.2),
            (self._uavs, style.UAV, "o", 1.4),
        ):
            for k, name in enumerate(names):
                code = style.color(colors, k)
                (self._lines[name],) = axes.plot([], [], color=code, linewidth=thick, zorder=4)
                (self._bodies[name],) = axes.plot(
                    [],
                    [],
                    marker,
                    color=code,
                    markersize=9,
                    markeredgecolor="white",
                    markeredgewidth=1.2,
                    zorder=7,
                )
        self._rings = self._make_rings()
        self._artists += [
            *self._lines.values(),
            *(ring for _, ring in self._rings),
            *self._bodies.values(),
        ]
        self._draw_texts(total)
        for artist in self._artists:
            artist.set_animated(True)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)  # type: ignore[no-untyped-call]

    def _draw_goals(self) -> None:
        for ugv in self._scenario.ugv if self._scenario is not None else ():
            code = style.color(style.UGV, self._ugvs.index(ugv.name))
            for goal in ugv.goals:
                (mark,) = self._axes.plot(
                    *goal, marker="x", markersize=6, markeredgewidth=1.8, color=code, zorder=3.5
                )
                self._artists.append(mark)

    def _make_rings(self) -> list[tuple[str, Circle]]:
        """Circles and the vehicles that carry them; none where the scenario is not known."""
        scenario = self._scenario
        if scenario is None:
            return []
        rings = []
        for ugv in sorted(set(self._escorts.values())):
            r_s = inner_radius(scenario, ugv)
            red: dict[str, Any] = {"fill": False, "edgecolor": style.LIMIT, "zorder": 5}
            rings.append(
                (ugv, Circle((0.0, 0.0), scenario.visibility.radius, linewidth=1.8, **red))
            )
            if r_s is not None:
                rings.append(
                    (ugv, Circle((0.0, 0.0), r_s, linewidth=1.2, linestyle=style.DASHED, **red))
                )
        for k, uav in enumerate(self._uavs):
            blue: dict[str, Any] = {
                "fill": False,
                "edgecolor": style.color(style.UAV, k),
                "zorder": 5,
            }
            rings.append((uav, Circle((0.0, 0.0), scenario.sensor.range, linewidth=0.8, **blue)))
        for _, ring in rings:
            self._axes.add_patch(ring)
        return rings

    def _draw_texts(self, total: int) -> None:
        head, figure = self._recording.head, self._figure
        left = _SIDE / 2 / WIDTH
        law = f"law {self._scenario.law.name}   ·   " if self._scenario is not None else ""
        figure.text(
            left,
            1.0 - 20 / total,
            head.name,
            fontsize=13,
            fontweight="bold",
            va="top",
            parse_math=False,
        )
        figure.text(
            left,
            1.0 - 58 / total,
            f"{law}seed {head.seed}",
            color=style.MUTED,
            va="top",
            parse_math=False,
        )
        right: dict[str, Any] = {
            "va": "top",
            "ha": "right",
            "animated": True,
            "fontfamily": "DejaVu Sans Mono",
        }
        self._clock = figure.text(
            1.0 - left, 1.0 - 20 / total, "", fontsize=11, fontweight="bold", **right
        )
        self._distance = figure.text(1.0 - left, 1.0 - 58 / total, "", **right)
        self._artists += [self._clock, self._distance]
        keys = style.vehicle_keys(len(self._uavs), len(self._ugvs))
        if self._scenario is not None:
            keys.append(style.key(style.LIMIT, "limit of sight $r_v$"))
            if any(
                ring.get_linestyle() != "solid" and ring.get_linestyle() != "-"
                for _, ring in self._rings
            ):
                keys.append(
                    style.key(
                        style.LIMIT, "only tracking, $r_s$", linestyle=(0, (3, 1.6)), linewidth=1.2
                    )
                )
            keys.append(style.key(style.UAV[0], "range of the sensor", linewidth=0.8))
        else:
            keys = keys[:2]
        figure.legend(
            handles=keys,
            loc="lower center",
            ncols=len(keys),
            columnspacing=1.3,
            fontsize=7.5,
            handletextpad=0.5,
        )

    def frames(self, times: "FloatArray | list[float]") -> "Iterator[np.ndarray[Any, Any]]":
        """The frames at these simulated times [s], which rise; shape (height, width, 4), uint8."""
        for time in times:
            self._show(float(time))
            self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
            for artist in sorted(self._artists, key=lambda artist: artist.get_zorder()):
                self._figure.draw_artist(artist)
            yield np.array(self._canvas.buffer_rgba())  # type: ignore[no-untyped-call]

    def _show(self, time: float) -> None:
        row = max(0, int(np.searchsorted(self.times, time + 1e-9, side="right")) - 1)
        truth = self._recording.truths[row]
        while self._waiting is not None and self._waiting.tick <= truth.tick:
            ground = np.frombuffer(self._waiting.cells, dtype=np.uint8)
            self._ground.set_data(ground.reshape(self._waiting.rows, self._waiting.columns))
            self._waiting = next(self._maps, None)
        for name, track in self._tracks.items():
            self._lines[name].set_data(track[: row + 1, 0], track[: row + 1, 1])
            self._bodies[name].set_data(track[row : row + 1, 0], track[row : row + 1, 1])
        for name, ring in self._rings:
            ring.center = (float(self._tracks[name][row, 0]), float(self._tracks[name][row, 1]))
        distance = max(escort.distance for escort in truth.escorts)
        r_v = self._scenario.visibility.radius if self._scenario is not None else np.inf
        limit = f" of {r_v:g} m" if np.isfinite(r_v) else ""
        self._clock.set_text(f"{truth.time:7.1f} s")
        self._distance.set_text(
            f"distance {distance:5.2f} m{limit}" + ("  OUT OF SIGHT" if distance >= r_v else "")
        )
        self._distance.set_color(style.LIMIT if distance >= r_v else style.MUTED)
