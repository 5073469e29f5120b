"""Further endpoints of a run, at which operators and observers join it."""

import shlex
from pathlib import Path
from typing import NamedTuple

from bus.credentials import CredentialSet


class Listening(NamedTuple):
    """Endpoints of a run's router besides its private socket, and the credentials that it accepts."""

    endpoints: tuple[str, ...] = ()
    given: CredentialSet | None = None
    """Credentials of all parties; None: new ones for this run."""
    folder: Path | None = None
    """Folder with the files of `given`."""

    def joining(self, endpoint: str, run: str, credential: Path) -> str:
        """Return the options of a party that the user starts.

        Args:
            endpoint: Endpoint of the router.
            run: Name of the run.
            credential: File in the run's private folder; the user's own file of this name is preferred.
        """
        own = self.folder / credential.name if self.folder is not None else credential
        file = own if own.exists() else credential
        return shlex.join(["--connect", endpoint, "--run", run, "--credentials", str(file)])


PRIVATE = Listening()
"""No further endpoint."""
