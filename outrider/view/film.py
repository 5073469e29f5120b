"""Picture of a recorded flight as PNG, or a film from above as GIF or MP4."""

import math
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from bus.errors import ScenarioError
from bus.files import writing
from bus.messages.telemetry import Truth
from outrider.recording.reader import Recording, coverages, flight_of, grounds
from outrider.recording.refly import external_uavs, from_the_start, restore
from outrider.view.flight_picture import draw_flight
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import code
from sim.scenario.types import NO_UAV
from sim.scene.altitude import altitudes_of, decisive, sight_of, worst_sight
from sim.scene.colors import (
    BUILDINGS,
    COVERED,
    FAINT,
    HAZARDS,
    INK,
    LIMIT,
    MUTED,
    SHADOW,
    TILES,
    UAV,
    UGV,
    covered,
    mixed,
    rgb,
)
from sim.scene.frames import Frames
from sim.scene.known import scene_of
from sim.scene.model import Moment, headings_of, observed_scene
from sim.scene.team import occurring
from sim.server.flight import control_title

WIDTH = 800
"""Width of a film [px]."""
ENDINGS = (".png", ".gif", ".mp4")

Picture = np.ndarray[Any, Any]
"""RGBA image, shape (height, width, 4), uint8."""
Progress = Callable[[int, int], None]
"""Callback with the number of drawn frames and of all frames."""


def check_output(out: Path) -> None:
    """Check the output file before any work is done.

    Raises:
        ScenarioError: If the ending is unknown, or ffmpeg is needed but missing.
    """
    if out.suffix.lower() not in ENDINGS:
        raise ScenarioError(f"{out}: unknown ending {out.suffix!r}; allowed: {', '.join(ENDINGS)}")
    if out.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise ScenarioError(
            f"{out}: MP4 needs ffmpeg, which is not on the PATH; allowed without it: .gif, .png"
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
        recording: Recording with at least one tick.
        out: File to write; its ending selects a picture or a film.
        fps: Frames per second of a film.
        speed: Simulated seconds per second of a film.
        on_frame: Called after each frame with the progress.

    Raises:
        ScenarioError: If the recording cannot be drawn.
        OSError: If the file cannot be written.
    """
    check_output(out)
    ending = out.suffix.lower()
    if ending == ".png" and recording.head.scenario is not None and from_the_start(recording):
        draw_flight(restore(recording), out, recording.last_ground)
        on_frame(1, 1)
        return
    film = Film(recording)
    shown = film.times[-1:] if ending == ".png" else film.frame_times(speed / fps)
    frames = _counted(film.frames(shown), len(shown), on_frame)
    if ending == ".png":
        with writing(out):
            Image.fromarray(next(frames)).convert("RGB").save(out, format="PNG")
    elif ending == ".gif":
        _write_gif(frames, out, fps, hazards=film.hazards)
    else:
        _write_mp4(frames, out, fps)


def render_file(
    file: Path,
    out: Path,
    *,
    flight: int | None,
    fps: int,
    speed: float,
    on_frame: Progress,
) -> None:
    """Draw one flight of a recording; arguments and errors as in `flight_of` and `render`."""
    check_output(out)  # before a long recording is read
    render(flight_of(file, flight), out, fps=fps, speed=speed, on_frame=on_frame)


def _counted(frames: Iterator[Picture], total: int, on_frame: Progress) -> Iterator[Picture]:
    for done, frame in enumerate(frames, 1):
        yield frame
        on_frame(done, total)


def _hazard_colors() -> Iterator[str]:
    """Yield the colors of hazards: tiles on covered and uncovered ground, and strong and faint hazards."""
    for color, opacity in TILES:
        yield from (mixed(paper, color, opacity) for paper in COVERED if opacity)
    unknown = mixed(COVERED[0], *TILES[0])
    for color in HAZARDS.values():
        yield from (mixed(unknown, color, share) for share in (FAINT, 1.0))
        yield mixed(COVERED[-1], color, 0.5)
    yield from (mixed(*BUILDINGS, share) for share in (0.0, 0.25, 0.5, 0.75, 1.0))
    for opacity in SHADOW[1:]:
        yield from (mixed(paper, SHADOW[0], opacity) for paper in COVERED)


def _palette(*, hazards: bool) -> Image.Image:
    """Return the palette of a GIF; it is the same for all frames, so that nothing flickers."""
    colors = ["#ffffff", *(covered(k / 31.0) for k in range(32))]
    colors += _hazard_colors() if hazards else ()
    for ink in (LIMIT, INK, MUTED, *UAV[:3], *UGV[:3]):
        for paper in ("#ffffff", *COVERED[1:]):
            colors += [mixed(paper, ink, share) for share in np.linspace(0.15, 1.0, 7).tolist()]
    image = Image.new("P", (1, 1))
    image.putpalette([round(255.0 * part) for color in colors[:256] for part in rgb(color)])
    return image


def _write_gif(frames: Iterator[Picture], out: Path, fps: int, *, hazards: bool) -> None:
    palette = _palette(hazards=hazards)
    colored = (Image.fromarray(frame).convert("RGB") for frame in frames)
    pictures = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in colored)
    first = next(pictures)
    duration = round(1000.0 / fps)
    with writing(out), out.open("wb") as file:
        first.save(
            file,
            format="GIF",
            save_all=True,
            append_images=pictures,
            duration=duration,
            loop=0,
            optimize=False,
        )


def _write_mp4(frames: Iterator[Picture], out: Path, fps: int) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{width}x{height}", "-r", str(fps)]
    # An absolute path: ffmpeg reads a leading '-' as an option, and text before ':' as a protocol.
    coded = ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(out.absolute())]
    program = shutil.which("ffmpeg") or "ffmpeg"
    with subprocess.Popen(
        [program, "-y", "-loglevel", "error", *raw, "-i", "-", *coded],
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
            pass  # ffmpeg reports the reason
        message = stderr.read().decode(errors="replace")
    if ffmpeg.returncode:
        raise OSError(0, f"ffmpeg: {' '.join(message.split()) or ffmpeg.returncode}", str(out))


class Film:
    """Film of one flight from above.

    Args:
        recording: Recording with at least one tick.
    """

    def __init__(self, recording: Recording) -> None:
        self._truths = recording.truths
        first = self._truths[0]
        self.times: FloatArray = np.array([truth.time for truth in self._truths])
        """Simulated times of the recorded ticks [s]."""
        self._tracks: dict[str, FloatArray] = {
            name: np.array([truth.vehicles[name].position for truth in self._truths])
            for name in first.vehicles
        }
        self._maps = coverages(recording.path, flight=recording.number)
        self._waiting = next(self._maps, None)
        self._grounds = grounds(recording.path, flight=recording.number)
        self._ground_waiting = next(self._grounds, None)
        self.hazards = self._ground_waiting is not None
        """True if the ground has hazards."""
        head = recording.head
        facts = f"seed {head.seed}"
        self._r_v = math.inf
        if head.scenario is not None:
            scenario = recording.scenario
            scene = scene_of(scenario, recording.buildings)
            law = control_title(scenario, external_uavs(recording))
            facts = f"law {law}   ·   {facts}" if scenario.uav else f"{NO_UAV}   ·   {facts}"
            self._r_v = scenario.visibility.radius
        else:
            escorts = {escort.uav: escort.ugv for escort in first.escorts}
            scene = observed_scene(
                head.name,
                None,
                escorts=escorts,
                vehicles=first.vehicles,
                ground=self._ground(),
            )
        self._roles = _roles_in(self._truths)
        reported = any(escort.report for escort in self._truths[-1].escorts)
        self._frames = Frames(
            scene,
            width=WIDTH,
            facts=facts,
            estimates=reported,
            hazards=self._ground_waiting,
            roles=occurring(self._roles),
        )

    def frame_times(self, step: float) -> FloatArray:
        """Return simulated times [s] at a distance of `step` [s], including the flight's end."""
        found: FloatArray = np.append(
            np.arange(self.times[0], self.times[-1], step), self.times[-1]
        )
        return found

    def _ground(self) -> tuple[float, float]:
        """Return width and height of the ground [m], estimated from a recording without scenario."""
        ground = self._waiting
        if ground is not None:
            return ground.columns * ground.cell, ground.rows * ground.cell
        x, y = np.concatenate(list(self._tracks.values())).max(axis=0).tolist()
        return x + 5.0, y + 5.0

    def frames(self, times: FloatArray | list[float]) -> Iterator[Picture]:
        """Yield the frames at these increasing simulated times [s]."""
        for time in times:
            row = int(np.searchsorted(self.times, float(time) + 1e-9, side="right")) - 1
            yield self._frame(max(0, row))

    def _frame(self, row: int) -> Picture:
        truth = self._truths[row]
        coverage = None
        while self._waiting is not None and self._waiting.tick <= truth.tick:
            cells = np.frombuffer(self._waiting.cells, dtype=np.uint8)
            coverage = cells.reshape(self._waiting.rows, self._waiting.columns) / 255.0
            self._waiting = next(self._maps, None)
        hazards = None
        while self._ground_waiting is not None and self._ground_waiting.tick <= truth.tick:
            hazards, self._ground_waiting = self._ground_waiting, next(self._grounds, None)
        estimates = {
            escort.uav: (escort.report.estimate, escort.report.covariance)
            for escort in truth.escorts
            if escort.report is not None
        }
        return self._frames.draw(
            {name: track[: row + 1] for name, track in self._tracks.items()},
            coverage,
            estimates,
            time=truth.time,
            sight=worst_sight(sight_of(one, self._r_v) for one in decisive(truth.escorts)),
            hazards=hazards,
            moment=Moment(
                altitudes=altitudes_of(truth.vehicles),
                headings=headings_of(truth.vehicles),
                hidden={escort.uav for escort in truth.escorts if escort.sight_radius == 0.0},
            ),
            roles={name: roles[: row + 1] for name, roles in self._roles.items()},
        )


def _roles_in(truths: Sequence[Truth]) -> dict[str, IntArray]:
    """Return the code of the role in each truth of each UAV that has reported one, 0: none. Shape (truths,)."""
    found = {escort.uav: np.zeros(len(truths), dtype=np.int64) for escort in truths[-1].escorts}
    for k, truth in enumerate(truths):
        for escort in truth.escorts:
            if escort.report is not None and escort.report.role is not None:
                found[escort.uav][k] = code(escort.report.role)
    return {uav: roles for uav, roles in found.items() if roles.any()}
