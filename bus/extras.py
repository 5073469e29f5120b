"""The optional extras: which packages each needs, and a refusal in one line where one is not installed."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from bus.errors import OutriderError, ScenarioError

EXTRAS = {
    "record": ("foxglove", "mcap"),
    "drive": ("textual",),
    "dashboard": ("nicegui",),
    "window": ("pygame",),
    "sweep": ("pyarrow",),
    "dask": ("distributed",),
    "falsify": ("cma",),
    "tls": ("cryptography",),
    "ros2": ("rosbags", "xxhash"),
    "mavlink": ("pymavlink",),
    "fmi": ("fmpy", "pythonfmu3"),
    "sb3": ("stable_baselines3", "torch"),
    "torchrl": ("torchrl",),
    "rllib": ("ray",),
    "supersuit": ("supersuit",),
}
"""The packages of each extra, by the names under which it is imported."""


def missing_of(extra: str) -> list[str]:
    """The packages of an extra that are not installed."""
    return [module for module in EXTRAS[extra] if find_spec(module) is None]


def install_command(extra: str) -> str:
    """Installs it from the clone."""
    return f"pip install -e '.[{extra}]'"


def check_extra(extra: str, *needed: str, what: str = "") -> None:
    """Refuse to begin without an extra.

    Args:
        extra: Its name.
        needed: Those of its packages without which it cannot begin; by default all.
        what: It needs them.

    Raises:
        ScenarioError: If one is not installed; with the command that installs it.
    """
    with from_extra(extra, what):
        for module in missing_of(extra):
            if not needed or module in needed:
                raise ImportError(name=module)


@contextmanager
def from_extra(
    extra: str, what: str = "", kind: type[OutriderError] = ScenarioError
) -> Iterator[None]:
    """Around imports from an extra: one that fails is told as by `check_extra`, as an error of this kind."""
    try:
        yield
    except ImportError as absent:
        needs = f"{what}: " if what else ""
        told = f"{needs}{absent.name} is missing: {install_command(extra)}"
        raise kind(told) from absent
