"""The optional extras: which packages each needs, and a refusal in one line where one is not installed."""

from importlib.util import find_spec

from bus.errors import ScenarioError

EXTRAS = {
    "record": ("foxglove", "mcap"),
    "drive": ("textual",),
    "dashboard": ("nicegui",),
    "window": ("pygame",),
    "sweep": ("joblib", "pyarrow"),
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


def check_extra(extra: str, *needed: str) -> None:
    """Refuse to begin without an extra.

    Args:
        extra: Its name.
        needed: Those of its packages without which it cannot begin; by default all.

    Raises:
        ScenarioError: If one is not installed; with the command that installs it.
    """
    for module in missing_of(extra):
        if not needed or module in needed:
            raise ScenarioError(f"{module} is missing: pip install -e '.[{extra}]'")
