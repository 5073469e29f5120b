"""The environment's pictures, for a caller or for a person at a window; what draws is loaded with the first one.

The window is pygame's, which is the extra [window].
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
from sim.scene.known import scene_of
from sim.scene.told_tiles import ground_map
from sim.world import World

if TYPE_CHECKING:
    from sim.scene.frames import Frames

_WIDTH = 936
"""Of a picture [px]."""


class Window:
    """Opens with its first picture. Once a person has closed it, it stays closed.

    Args:
        title: Of the window.
        rate: Largest number of pictures per second.

    Raises:
        OutriderError: If pygame is missing.
    """

    def __init__(self, title: str, rate: float) -> None:
        with needs("window", "render_mode 'human', unlike 'rgb_array'"):
            self._pygame: Any = importlib.import_module("pygame")  # without types
        self._title, self._rate = title, rate
        self._screen: Any = None
        self._clock = self._pygame.time.Clock()
        self.closed = False
        """True if it was closed."""

    def _open(self, size: tuple[int, int]) -> None:
        pygame = self._pygame
        try:
            pygame.display.init()
            # SDL's last resort is "offscreen": nobody would see it
            seen = pygame.display.get_driver() != "offscreen"
            self._screen = pygame.display.set_mode(size) if seen else None
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
    """The pictures of one scenario's worlds, all on one canvas."""

    def __init__(self) -> None:
        self._frames: Frames | None = None
        self._hazards: tuple[Hazard, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """A copy draws on a canvas of its own."""
        return self.__dict__ | {"_frames": None}

    def draw(
        self,
        world: World,
        ways: FloatArray,
        routes: Mapping[str, tuple[Vector, ...]] = MappingProxyType({}),
    ) -> npt.NDArray[np.uint8]:
        """The picture of a world at this moment. Shape (rows, columns, 3).

        Args:
            world: Which.
            ways: The way of each vehicle so far [m]. Shape (ticks, vehicles, 2).
            routes: The way that each UGV plans, by its corners [m].
        """
        from sim.scene.frames import Frames  # noqa: PLC0415 - matplotlib is loaded when someone looks

        ground = ground_map(world, routes=routes)
        hazards = () if ground is None else ground.hazards
        if self._frames is None or self._hazards != hazards:
            self._frames = Frames(scene_of(world.scenario), width=_WIDTH, hazards=ground)
            self._hazards = hazards
        distances, errors = world.measure().T.tolist()
        frame = self._frames.draw(
            {name: ways[:, k] for k, name in enumerate(world.names)},
            np.minimum(world.coverage / world.parameters.desired, 1.0),
            time=world.time,
            distance=max(distances, default=None),
            r_v=world.parameters.r_v,
            facts=f"{'sum of ' if len(errors) > 1 else ''}e(t) = {sum(errors):.0f} m²"
            if errors
            else "no UAV",
            hazards=ground,
        )
        return frame[:, :, :3].copy()


class Rendering:
    """One environment's pictures.

    Args:
        mode: "rgb_array" or "human".
        rate: Pictures per second that a person is shown.
    """

    def __init__(self, mode: str, rate: float) -> None:
        self._mode, self._rate = mode, rate
        self._tracks: list[list[list[float]]] = []
        self._routes: dict[str, tuple[Vector, ...]] = {}
        self._drawing = Drawing()
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        """A copy of an environment has a window of its own."""
        return self.__dict__ | {"_window": None}

    def follow(self, world: World) -> None:
        """Take in the next tick, and show it where a person looks; tick 0 begins anew."""
        if world.tick == 0:
            self._tracks, self._routes = [], {}
        self._tracks.append(world.position.tolist())
        if self._mode == "human":
            self.render(world)

    def show_route(self, ugv: str, route: tuple[Vector, ...]) -> None:
        """The way that a UGV plans, by its corners [m], until it plans another."""
        self._routes[ugv] = route

    def render(self, world: World) -> npt.NDArray[np.uint8] | None:
        """The picture of this moment; None where it is shown to a person instead.

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
        """Close the window; the next picture opens another."""
        if self._window is not None:
            self._window.close()
            self._window = None


class BatchRendering:
    """The pictures of many worlds.

    Args:
        batch: Their state.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch, self._drawing = batch, Drawing()
        # A world's track ends the list: one position for each tick of its episode.
        self._tracks: deque[FloatArray] = deque(maxlen=batch.scenario.ticks + 1)

    def begin(self, worlds: IntArray) -> None:
        """Take in that these worlds are at the start of an episode."""
        if self._tracks:
            self._tracks[-1][worlds] = self._batch.state.vehicles["position"][worlds]
        else:
            self.follow()

    def follow(self) -> None:
        """Take in the tick that all worlds are at."""
        self._tracks.append(self._batch.state.vehicles["position"].copy())

    def render(self) -> tuple[npt.NDArray[np.uint8], ...]:
        """The picture of each world at this moment."""
        pictures = []
        for k in range(self._batch.worlds):
            world = World.of_batch(self._batch, k, 0)
            last = itertools.islice(reversed(self._tracks), world.tick + 1)
            ways = np.array([positions[k] for positions in last])[::-1]
            pictures.append(self._drawing.draw(world, ways))
        return tuple(pictures)
