"""Rendering of environments, as arrays or in a window; the drawing code is loaded with the first picture.

The window uses pygame (extra [window]).
"""

import importlib
import itertools
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from bus.errors import OutriderError
from bus.messages.base import Vector
from bus.messages.ground import Hazard
from bus.plugins import needs
from sim.compiling.compile import FloatArray, IntArray
from sim.engine.batch import Batch
from sim.scene.altitude import worst_sight
from sim.scene.ground_map import ground_map
from sim.scene.known import scene_of
from sim.scene.model import Moment
from sim.world import World

if TYPE_CHECKING:
    from sim.scene.frames import Frames

_WIDTH = 936
"""Width of a picture [px]."""


class Window:
    """Window that opens with its first picture, and stays closed after the user has closed it.

    Args:
        title: Title of the window.
        rate: Maximum number of pictures per second.

    Raises:
        OutriderError: If pygame is missing.
    """

    def __init__(self, title: str, rate: float) -> None:
        with needs("window", "render_mode 'human', unlike 'rgb_array'"):
            self._pygame: Any = importlib.import_module("pygame")  # no type hints available
        self._title, self._rate = title, rate
        self._screen: Any = None
        self._clock = self._pygame.time.Clock()
        self.closed = False
        """True if the user has closed it."""

    def _open(self, size: tuple[int, int]) -> None:
        pygame = self._pygame
        try:
            pygame.display.init()
            # SDL falls back to "offscreen", which is invisible
            visible = pygame.display.get_driver() != "offscreen"
            self._screen = pygame.display.set_mode(size) if visible else None
        except pygame.error:
            self._screen = None
        if self._screen is None:
            pygame.display.quit()
            raise OutriderError(
                "render_mode 'human' needs a display and found none; use 'rgb_array'"
            )
        pygame.display.set_caption(self._title)

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture, shape (rows, columns, 3), and wait until the next one is due.

        Raises:
            OutriderError: If there is no display.
        """
        if self.closed:
            return
        rows, columns = picture.shape[:2]
        if self._screen is None:
            self._open((columns, rows))
        image = self._pygame.image.frombuffer(picture.tobytes(), (columns, rows), "RGB")
        self._screen.blit(image, (0, 0))
        self._pygame.display.flip()
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()
        else:
            self._clock.tick(self._rate)

    def close(self) -> None:
        """Close the window."""
        if not self.closed:
            self.closed = True
            self._screen = None
            self._pygame.display.quit()


class Drawing:
    """Pictures of one scenario's worlds, on a common canvas."""

    def __init__(self) -> None:
        self._frames: Frames | None = None
        self._hazards: tuple[Hazard, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """Exclude the canvas: a copy draws on its own."""
        return self.__dict__ | {"_frames": None}

    def draw(
        self,
        world: World,
        paths: FloatArray,
        routes: Mapping[str, tuple[Vector, ...]] = MappingProxyType({}),
    ) -> npt.NDArray[np.uint8]:
        """Return the picture of a world at this moment. Shape (rows, columns, 3).

        Args:
            world: World to draw.
            paths: Path of each vehicle so far [m]. Shape (ticks, vehicles, 2).
            routes: Planned route of each UGV: its corners [m].
        """
        from sim.scene.frames import Frames  # noqa: PLC0415 - matplotlib is loaded with the first picture

        ground = ground_map(world, routes=routes)
        hazards = () if ground is None else ground.hazards
        if self._frames is None or self._hazards != hazards:  # buildings are hazards, too
            scene = scene_of(world.scenario, world.buildings)
            self._frames = Frames(scene, width=_WIDTH, hazards=ground)
            self._hazards = hazards
        distances, errors = world.measure().T.tolist()
        radii = world.vehicles["sight_radius"][world.escorts[:, 0]].tolist()
        heights = world.vertical["altitude"].tolist()
        frame = self._frames.draw(
            {name: paths[:, k] for k, name in enumerate(world.names)},
            np.minimum(world.coverage / world.parameters.desired, 1.0),
            time=world.time,
            sight=worst_sight(zip(distances, radii, strict=True)),
            facts=f"{'sum of ' if len(errors) > 1 else ''}e(t) = {sum(errors):.0f} m²"
            if errors
            else "no UAV",
            hazards=ground,
            moment=Moment(
                altitudes={
                    uav.name: heights[k]
                    for uav, k in zip(world.uavs, world.escorts[:, 0].tolist(), strict=True)
                    if uav.initial_altitude is not None
                },
                headings=world.headings(),
                hidden={
                    uav.name for uav, radius in zip(world.uavs, radii, strict=True) if radius == 0.0
                },
            ),
        )
        return frame[:, :, :3].copy()


class Rendering:
    """Pictures of one environment.

    Args:
        mode: "rgb_array" or "human".
        rate: Pictures per second in the window.
    """

    def __init__(self, mode: str, rate: float) -> None:
        self._mode, self._rate = mode, rate
        self._tracks: list[list[list[float]]] = []
        self._routes: dict[str, tuple[Vector, ...]] = {}
        self._drawing = Drawing()
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Exclude the window: a copy of an environment opens its own."""
        return self.__dict__ | {"_window": None}

    def follow(self, world: World) -> None:
        """Record the next tick, and show it in mode "human"; tick 0 restarts the paths."""
        if world.tick == 0:
            self._tracks, self._routes = [], {}
        self._tracks.append(world.position.tolist())
        if self._mode == "human":
            self.render(world)

    def show_route(self, ugv: str, route: tuple[Vector, ...]) -> None:
        """Set the planned route of a UGV: its corners [m]."""
        self._routes[ugv] = route

    def render(self, world: World) -> npt.NDArray[np.uint8] | None:
        """Return the picture of this moment; None in mode "human", which shows it.

        Raises:
            OutriderError: If there is no display, or no pygame.
        """
        if self._mode == "human":
            self._show(world)
            return None
        return self._draw(world)

    def _draw(self, world: World) -> npt.NDArray[np.uint8]:
        return self._drawing.draw(world, np.array(self._tracks), self._routes)

    def _show(self, world: World) -> None:
        if self._window is None:
            self._window = Window(f"Outrider: {world.scenario.name}", self._rate)
        if not self._window.closed:
            self._window.show(self._draw(world))

    def close(self) -> None:
        """Close the window; the next picture opens a new one."""
        if self._window is not None:
            self._window.close()
            self._window = None


class BatchRendering:
    """Pictures of many worlds.

    Args:
        batch: Batch of worlds.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch, self._drawing = batch, Drawing()
        # A world's path is the end of the list: one position for each tick of its episode.
        self._tracks: deque[FloatArray] = deque(maxlen=batch.scenario.ticks + 1)

    def begin(self, worlds: IntArray) -> None:
        """Record the start of an episode in these worlds."""
        if self._tracks:
            self._tracks[-1][worlds] = self._batch.state.vehicles["position"][worlds]
        else:
            self.follow()

    def follow(self) -> None:
        """Record the present tick of all worlds."""
        self._tracks.append(self._batch.state.vehicles["position"].copy())

    def render(self) -> tuple[npt.NDArray[np.uint8], ...]:
        """Return the picture of each world at this moment."""
        pictures = []
        for k in range(self._batch.worlds):
            world = World.of_batch(self._batch, k, 0)
            last = itertools.islice(reversed(self._tracks), world.tick + 1)
            paths = np.array([positions[k] for positions in last])[::-1]
            pictures.append(self._drawing.draw(world, paths))
        return tuple(pictures)
