"""Rows of the registry: all that others need to know of a law, a driver, a sensor, a hazard or a saved policy.

A package that adds a law, a driver or a sensor makes its row in a module that imports nothing else of Outrider.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LawRow:
    """A law of the UAVs."""

    name: str
    module: str = ""
    """Its file, with `Parameters`, `Memory` and `command`; empty where the user's policy flies in its place."""
    about: str
    """One line, for help texts."""
    covers: bool = False
    """True if it steers by the coverage gradient, and so by v_ref of (10)."""
    needs_radius: bool = True
    """True if it needs a positive switching radius r_s (18)."""
    keeps_sight: bool = True
    """True if it ever turns back to the UGV."""
    own: str = ""
    """The field of `[custom]` that names the function of the user's own which it needs."""
    inner: str = ""
    """The field of `[custom]` whose policy flies in its place inside the safety filter, where one is named."""
    watched: bool = False
    """True if the safety filter stands behind it."""
    separate: bool = False
    """True if a batch contains it only where it is flown, as it takes long to compile."""
    color: str
    """Color of its lines in pictures and tables."""
    mark: str = "o"
    """Marker of its points, by its name in matplotlib."""

    @property
    def compared(self) -> bool:
        """True if it flies in every comparison: it keeps sight and needs nothing of the user's own."""
        return self.keeps_sight and not self.own


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverRow:
    """A driver of the UGVs."""

    name: str
    about: str
    """One line, for help texts."""
    module: str = ""
    """Its file, with `Parameters`, `Memory` and `command`; empty: it is not compiled, and drives in no batch."""
    make: str = ""
    """The class that drives, made from a `UgvBriefing`, where that is not the file alone."""
    needs: str = ""
    """The field of `[[ugv]]` without which it cannot drive."""
    wants: str = ""
    """The field of `[[ugv]]` without which it stands still."""
    listens: bool = False
    """True if it uses what the UAV radios."""
    avoids: bool = True
    """False if it drives where it wants, whatever hazards are there."""
    unbounded: bool = False
    """True if it drives without a bound where the UGV has none; the others assume a large one."""
    separate: bool = False
    """True if a batch contains it only where it drives over ground, as it takes long to compile."""
    operated: bool = False
    """True if it does what an operator says."""
    own: str = ""
    """The field of `[custom]` that names what drives."""
    outside: bool = False
    """True if it is a process of the user's own, from start to end."""

    @property
    def provided(self) -> bool:
        """True if its code is neither a function nor a process of the user's own."""
        return bool(self.module or self.make)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRow:
    """A sensor of the ground."""

    name: str
    module: str
    """Its file, with the compiled functions `quality` and `slope` of the squared distance."""
    about: str
    """One line, for help texts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HazardKindRow:
    """A kind of hazards on the ground. Their geometry is in `sim.models.hazards`."""

    name: str
    code: int
    """State of a tile that one touches: 0 is a tile that nobody has seen, 1 a clear one."""
    about: str
    """One line, for help texts."""
    drivable: bool = True
    """False if a vehicle that touches it is stuck or damaged."""
    slows: bool = False
    """True if a vehicle keeps only a share of its largest speed on it."""
