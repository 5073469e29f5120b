"""All links of a run: those that the engine carries, and those that carry messages of operators and radios.

Every message crosses in simulated time, inside the simulator: the environment, three processes and containers meet
one network.
"""

from bus.errors import ScenarioError
from bus.messages import LinkKind, LinkSettings, LinkStatus
from sim.channel.description import Link, check_link
from sim.engine.batch import Batch
from sim.engine.link_arrays import PER_TICK, PURPOSES, owners
from sim.models.randomness import Key, WordArray
from sim.scenario.types import Scenario


def _key(words: WordArray) -> Key:
    """Two words of an array as they are: a compiled function would give them back as Python's own numbers."""
    return words[0], words[1]


class Links:
    """The links of one run.

    Args:
        scenario: What is flown.
        batch: The world: its links are those of detections and commands.
    """

    def __init__(self, scenario: Scenario, batch: Batch) -> None:
        rows = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
        self.table = scenario.links
        """The links' settings now, as a scenario would write them."""
        self._scenario, self._batch, keys = scenario, batch, batch.state.keys[0]
        self._of: dict[LinkKind, dict[str, Link]] = {
            kind: {
                name: Link(
                    scenario.links.of(name, kind),
                    dt=scenario.dt,
                    key=_key(keys[PURPOSES[kind], rows[name]]),
                    label=f"{name}/{kind}",
                    per_tick=PER_TICK[kind],
                    traces=scenario.links.traces,
                )
                for name in owners(scenario, kind)
            }
            for kind in (LinkKind.OPERATOR, LinkKind.RADIO)
        }

    def of(self, kind: LinkKind) -> dict[str, Link]:
        """The links of UGVs' operators, or of UAVs' radios, by vehicle."""
        return self._of[kind]

    @property
    def degraded(self) -> bool:
        """True if any of them does anything to a message."""
        carried = (link for links in self._of.values() for link in links.values())
        return not (self._batch.links.perfect and all(link.perfect for link in carried))

    def change(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> None:
        """Give links other settings; what is under way arrives as it would have.

        Args:
            kind: Which.
            vehicle: Whose; None: everybody's.
            settings: The new ones.

        Raises:
            ScenarioError: If the settings are impossible, or this vehicle has no such link.
        """
        names = owners(self._scenario, kind)
        if vehicle is not None and vehicle not in names:
            raise ScenarioError(
                f"vehicle = {vehicle!r}: has no link for its {kind}; allowed: {', '.join(names)}"
            )
        check_link(settings, str(kind), self.table.traces)
        for name in names if vehicle is None else (vehicle,):
            if kind in self._of:
                self._of[kind][name].change(settings)
            else:
                self._batch.change_link(kind, name, settings)
        self.table = self.table.changed(kind, vehicle, settings)

    def status(self, vehicle: str | None = None) -> dict[str, LinkStatus]:
        """Counters of each link so far, by `vehicle/kind`.

        Args:
            vehicle: Of this one alone; None: of all.
        """
        found = self._batch.links.status(0) | {
            f"{name}/{kind}": link.counters()
            for kind, links in self._of.items()
            for name, link in links.items()
        }
        return {key: one for key, one in found.items() if vehicle in (None, key.rpartition("/")[0])}
