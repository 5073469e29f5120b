"""Rows of the registry: descriptions of laws, drivers, sensors, bodies and kinds of hazards.

A package that adds a law, a driver, a sensor or a body makes its row in a module that imports nothing else from
Outrider but the parameters of laws, `bus.messages.laws`.
"""

from dataclasses import dataclass

from bus.messages.laws import LawParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class LawRow:
    """Control law of the UAVs."""

    name: str
    module: str = ""
    """Module with `Memory` and `command`; empty if the user's policy flies instead."""
    parameters: type[LawParameters] = LawParameters
    """Class of its `[law.parameters]`."""
    about: str
    """One-line description for help texts."""
    covers: bool = False
    """True if it uses the coverage gradient, and so v_ref of (10)."""
    needs_radius: bool = True
    """True if it needs a positive switching radius r_s (18)."""
    keeps_sight: bool = True
    """True if it returns to the UGV."""
    own: str = ""
    """Field of `[custom]` that names the user's function; required."""
    inner: str = ""
    """Field of `[custom]` with an optional policy that replaces it inside the safety filter."""
    watched: bool = False
    """True if the safety filter supervises it."""
    separate: bool = False
    """True if a batch compiles it only when it is used, because it takes long to compile."""
    color: str
    """Color of its lines in plots and tables."""
    mark: str = "o"
    """Marker of its points, by its matplotlib name."""

    @property
    def compared(self) -> bool:
        """True if every comparison includes it: it maintains visibility and needs no user code."""
        return self.keeps_sight and not self.own


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverRow:
    """Driver of the UGVs."""

    name: str
    about: str
    """One-line description for help texts."""
    module: str = ""
    """Module with `Parameters`, `Memory` and `command`; empty: not compiled, and not available in a batch."""
    make: str = ""
    """Class that drives, constructed from a `UgvBriefing`; empty: the module alone."""
    needs: str = ""
    """Required field of `[[ugv]]`."""
    wants: str = ""
    """Field of `[[ugv]]` without which the UGV stands still."""
    listens: bool = False
    """True if it uses the UAV's radio messages."""
    avoids: bool = True
    """False if it ignores hazards."""
    unbounded: bool = False
    """True if it drives without a bound if the UGV has none; other drivers assume a large bound."""
    separate: bool = False
    """True if a batch compiles it only for scenarios with ground, because it takes long to compile."""
    operated: bool = False
    """True if it follows an operator."""
    own: str = ""
    """Field of `[custom]` that names the user's function."""
    outside: bool = False
    """True if it is a separate process of the user's."""

    @property
    def provided(self) -> bool:
        """True if its code belongs to Outrider or an installed package, not to the user."""
        return bool(self.module or self.make)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorRow:
    """Sensor of the ground."""

    name: str
    module: str
    """Module with the compiled functions `quality` and `slope` of the squared distance."""
    about: str
    """One-line description for help texts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyRow:
    """Body of a UAV: the model of its true motion."""

    name: str
    about: str
    """One-line description for help texts."""
    make: str = ""
    """Class of `sim.models.body.Body`, constructed from a `Scenario` and its `Uav`; empty: the compiled inner loop."""
    reported: bool = False
    """True if the UAV's process reports the true motion, which a robot flies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HazardKindRow:
    """Kind of ground hazard. `sim.models.hazards` defines the geometry."""

    name: str
    code: int
    """State of a tile that touches one; 0 is an unknown tile, 1 a clear one."""
    about: str
    """One-line description for help texts."""
    drivable: bool = True
    """False if a vehicle that touches it is stuck or damaged."""
    slows: bool = False
    """True if it limits a vehicle to a share of its maximum speed."""
