"""Secret of a run, from the option `--secret`."""

from pathlib import Path

from bus.errors import ScenarioError
from sim.engine.run_keys import check_secret, new_secret


def secret_of(given: str, *, wanted: bool = False) -> str:
    """Return the run's secret.

    Args:
        given: Value of the option: @FILE, `new`, hexadecimal digits, or empty.
        wanted: True: make a secret if the option is empty.

    Raises:
        ScenarioError: If the secret is invalid, or its file cannot be read.
    """
    if given == "new" or (wanted and not given):
        return new_secret()
    source = "--secret"
    if given.startswith("@"):
        source = given[1:]
        try:
            with Path(source).open(encoding="ascii") as file:
                given = file.read(1000).strip()
        except (OSError, UnicodeDecodeError) as error:
            raise ScenarioError(
                f"--secret {source}: {getattr(error, 'strerror', '') or 'not a text file'}"
            ) from error
        if not given:
            raise ScenarioError(
                f"--secret {source}: the file is empty; allowed: 32 to 128 hexadecimal digits"
            )
    try:
        return check_secret(given, source)
    except ValueError as error:
        raise ScenarioError(str(error)) from error
