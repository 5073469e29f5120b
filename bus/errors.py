"""Errors that Outrider raises on purpose, grouped by who can fix them; and the position of an error in user code."""

import os
import sysconfig
import traceback

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_OURS = tuple(
    os.path.join(_ROOT, name) + os.sep
    for name in ("agents", "bus", "extensions", "outrider", "sim")
)
_LIBRARIES = tuple(
    os.path.realpath(sysconfig.get_path(name)) + os.sep
    for name in ("stdlib", "platstdlib", "purelib", "platlib")
)


def place_in_user_code(error: BaseException) -> str:
    """Return the innermost frame of an error in a user's file, such as `mine.py:3, in steer`; empty if none."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = os.path.realpath(frame.filename)
        if not frame.filename.startswith("<") and not file.startswith((*_OURS, *_LIBRARIES)):
            return f"{os.path.relpath(file)}:{frame.lineno}, in {frame.name}"
    return ""


def error_with_place(error: BaseException) -> str:
    """Return an error in user code with its type and position."""
    place = place_in_user_code(error)
    return f"{type(error).__name__}: {error}" + (f" ({place})" if place else "")


def shortened(text: str, longest: int = 160) -> str:
    """Return a text on one line; shorten a long one to its beginning and its end, where libraries give the reason."""
    flat = " ".join(text.split())
    if len(flat) <= longest:
        return flat
    head = longest // 3
    return f"{flat[:head]} ... {flat[-(longest - head - 5) :]}"


class OutriderError(Exception):
    """Base class of all Outrider errors; the message is one line."""


class Ended(SystemExit):
    """Request to end this process, such as SIGTERM; not the `sys.exit` of a package's code."""


class ScenarioError(OutriderError, ValueError):
    """Invalid scenario, a `ValueError` to be fixed by its author.

    The message names the file, the field, its value and what is allowed. `args` has a line for each fault: the first
    one only, unless all were asked for.
    """

    def __str__(self) -> str:
        """Return the lines, one below the other."""
        return "\n".join(map(str, self.args))


class BusError(OutriderError):
    """Failure of communication between processes."""


class AccessDenied(BusError):
    """Use of a key that the key table does not grant; nothing was sent."""


class PeerLost(BusError):
    """Another process did not join, or disconnected; the message names it."""
