"""Export of a vehicle, or of a whole run, as a file for FMI tools."""

import shutil
import tempfile
from pathlib import Path

from bus.errors import ScenarioError
from bus.keys import Role
from bus.plugins import needs
from outrider_fmi.unit_files import files_of
from outrider_fmi.vehicle_unit import check_exportable
from outrider_fmi.world_unit import check_world, packed
from sim.engine.briefing import briefing
from sim.scenario.types import Scenario

_PLACEHOLDER = {
    "slavemodule.txt": "outrider_placeholder",
    "outrider_placeholder.py": "from pythonfmu3 import Fmi3Slave\n\n\nclass Placeholder(Fmi3Slave):\n    pass\n",
}
"""Unit without behaviour, see `slave`."""


def export_vehicle(scenario: Scenario, role: Role, out: Path, *, name: str = "") -> str:
    """Export a vehicle as a co-simulation unit.

    Args:
        scenario: Scenario of the vehicle. Its pilot draws the random numbers of a run with this seed and no secret.
        role: UAV or UGV.
        out: File `*.fmu`; an existing one is replaced.
        name: Name of the vehicle; default: the first of its kind.

    Returns:
        Name of the vehicle.

    Raises:
        ScenarioError: If the vehicle is unknown, needs more than a unit has, or pythonfmu3 is missing.
        OSError: If the file cannot be written.
    """
    there = [one.name for one in (scenario.uav if role == Role.UAV else scenario.ugv)]
    if not there:
        raise ScenarioError(f"{scenario.name}: has no {role} to export")
    vehicle = name or there[0]
    if vehicle not in there:
        raise ScenarioError(
            f"--agent {name}: no {role} of {scenario.name}; allowed: {', '.join(there)}"
        )
    vehicle_briefing = briefing(scenario, vehicle, scenario.seed)
    check_exportable(vehicle_briefing)
    _build(files_of(vehicle_briefing), out)
    return vehicle


def export_world(scenario: Scenario, out: Path) -> None:
    """Export a whole run as a co-simulation unit; arguments and errors as of `export_vehicle`."""
    check_world(scenario)
    _build(files_of(packed(scenario)), out)


def _build(files: dict[str, bytes], out: Path) -> None:
    if out.suffix != ".fmu":
        raise ScenarioError(f"--out {out}: not a unit's name; allowed: FILE.fmu")
    with needs("fmi"):
        from pythonfmu3 import FmuBuilder  # noqa: PLC0415 - optional
    with tempfile.TemporaryDirectory(prefix="outrider-fmu-") as name:
        folder = Path(name)
        script = folder / "outrider_unit.py"
        shutil.copyfile(Path(__file__).with_name("slave.py"), script)
        placeholder = folder / "placeholder"
        placeholder.mkdir()
        for file, text in _PLACEHOLDER.items():
            (placeholder / file).write_text(text, "ascii")
        for file, content in files.items():
            (folder / file).write_bytes(content)
        made = FmuBuilder.build_FMU(
            script,
            dest=folder / "made",
            project_files=[placeholder, *(folder / file for file in files)],
            needsExecutionTool="true",
            canHandleVariableCommunicationStepSize="false",
        )
        shutil.move(made, out)
