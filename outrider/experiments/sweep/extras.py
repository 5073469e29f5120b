"""Tests before anything begins if a sweep's packages are installed, and says so in one line."""

from importlib.util import find_spec

from bus.errors import ScenarioError
from outrider.experiments.sweep import DASK_EXTRA, EXTRA


def check_extras(*modules: str) -> None:
    """Refuse to begin without these modules.

    Args:
        modules: Of `joblib`, `pyarrow` and `distributed`.

    Raises:
        ScenarioError: If one is not installed; with the command that installs it.
    """
    for module in modules:
        if find_spec(module) is None:
            raise ScenarioError(
                f"{module} is missing: pip install -e '{DASK_EXTRA if module == 'distributed' else EXTRA}'"
            )
