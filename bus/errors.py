"""Every error that Outrider raises on purpose, split by who must act; and where in a user's own code others begin."""

import os
import sysconfig
import traceback

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_OURS = tuple(os.path.join(_ROOT, name) + os.sep for name in ("agents", "bus", "outrider", "sim"))
_LIBRARIES = tuple(
    os.path.realpath(sysconfig.get_path(name)) + os.sep
    for name in ("stdlib", "platstdlib", "purelib", "platlib")
)


def place_in_user_code(error: BaseException) -> str:
    """The innermost frame of an error in a file of the user's own: `mine.py:3, in wheel`; empty where there is none."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = os.path.realpath(frame.filename)
        if not frame.filename.startswith("<") and not file.startswith((*_OURS, *_LIBRARIES)):
            return f"{os.path.relpath(file)}:{frame.lineno}, in {frame.name}"
    return ""


def told_with_place(error: BaseException) -> str:
    """An error of the user's own code with its type, and where it was raised."""
    place = place_in_user_code(error)
    return f"{type(error).__name__}: {error}" + (f" ({place})" if place else "")


def shortened(text: str, longest: int = 160) -> str:
    """A text on one line; of a longer one its beginning and its end, where libraries say what was wrong."""
    flat = " ".join(text.split())
    if len(flat) <= longest:
        return flat
    head = longest // 3
    return f"{flat[:head]} ... {flat[-(longest - head - 5) :]}"


class OutriderError(Exception):
    """Base of all errors below; its text is one line for a person."""


class ScenarioError(OutriderError):
    """The scenario must be mended by the person who wrote it.

    The text names the file, the field, its value and what is allowed.
    """


class BusError(OutriderError):
    """Something between the processes failed."""


class AccessDenied(BusError):
    """A role used a key that the key table does not give it; nothing was sent."""


class PeerLost(BusError):
    """Another process did not come, or went away; the text names it."""
