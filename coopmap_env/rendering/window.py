"""A window that shows pictures to a person."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.quiet import native_stderr_muted


class HumanWindow:
    """A window that shows RGB frames, opened by the first one.

    A person may close it at any time: from then on frames are dropped silently. pygame has one
    window per process, so that two of these objects use the same.
    """

    def __init__(self) -> None:
        self.closed_by_user = False
        self._pygame: Any = None

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show one (height, width, 3) frame and answer the window's events.

        Raises
        ------
        ImportError
            If pygame is not installed (extra "render").
        """
        if self.closed_by_user:
            return
        screen = self._screen(frame.shape[1], frame.shape[0])
        pixels = np.ascontiguousarray(frame, dtype=np.uint8).tobytes()
        screen.blit(self._pygame.image.frombuffer(pixels, screen.get_size(), "RGB"), (0, 0))
        self._pygame.display.flip()
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.closed_by_user = True
            self.close()

    def close(self) -> None:
        """Close the window, if there is one; may be called again."""
        if self._pygame is not None:
            self._pygame.display.quit()
            self._pygame = None

    def _screen(self, width: int, height: int) -> Any:
        if self._pygame is None:
            os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
            self._pygame = import_optional("pygame", "render")
        display = self._pygame.display
        with native_stderr_muted():  # libraries of displays that are not there complain
            display.init()
        screen = display.get_surface()
        if screen is None or screen.get_size() != (width, height):
            screen = display.set_mode((width, height))
            display.set_caption("coopmap")
        return screen
