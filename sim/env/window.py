"""A window that shows the environment's picture, by pygame, which is the extra [window]."""

import importlib
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.errors import OutriderError
from bus.extras import from_extra


class Window:
    """Opens with its first picture. Once a person has closed it, it stays closed.

    Args:
        title: Of the window.
        rate: Largest number of pictures per second.

    Raises:
        OutriderError: If pygame is missing.
    """

    def __init__(self, title: str, rate: float) -> None:
        with from_extra("window", "render_mode 'human', unlike 'rgb_array'"):
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
