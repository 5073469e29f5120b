"""A vehicle of a scenario, or the whole flight, as a file for FMI tools."""

import shutil
import tempfile
from pathlib import Path

from bus.errors import ScenarioError
from bus.keys import Role
from bus.plugins import needs
from outrider_fmi.carried import files_of
from outrider_fmi.vehicle_unit import check_exportable
from outrider_fmi.world_unit import check_world, packed
from sim.engine.briefing import briefing
from sim.scenario.types import Scenario

_HOLD = {
    "slavemodule.txt": "outrider_hold",
    "outrider_hold.py": "from pythonfmu3 import Fmi3Slave\n\n\nclass Hold(Fmi3Slave):\n    pass\n",
}
"""A unit that does nothing: see `slave`."""


def export_vehicle(scenario: Scenario, role: Role, out: Path, *, name: str = "") -> str:
    """Write the co-simulation unit of a vehicle.

    Args:
        scenario: Of which it is; its pilot's random numbers are those of a run with this seed and no secret.
        role: UAV or UGV.
        out: The file, whose name ends in `.fmu`; one that is there is replaced.
        name: The vehicle's; the first of its kind by default.

    Returns:
        The vehicle's name.

    Raises:
        ScenarioError: If there is no such vehicle, it needs more than a unit has, or pythonfmu3 is missing.
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
    told = briefing(scenario, vehicle, scenario.seed)
    check_exportable(told)
    _build(files_of(told), out)
    return vehicle


def export_world(scenario: Scenario, out: Path) -> None:
    """Write the co-simulation unit of a whole flight; arguments and errors as of `export_vehicle`."""
    check_world(scenario)
    _build(files_of(packed(scenario)), out)


def _build(carried: dict[str, bytes], out: Path) -> None:
    if out.suffix != ".fmu":
        raise ScenarioError(f"--out {out}: is no unit's name; allowed: FILE.fmu")
    with needs("fmi"):
        from pythonfmu3 import FmuBuilder  # noqa: PLC0415
    with tempfile.TemporaryDirectory(prefix="outrider-fmu-") as name:
        folder = Path(name)
        script = folder / "outrider_unit.py"
        shutil.copyfile(Path(__file__).with_name("slave.py"), script)
        hold = folder / "hold"
        hold.mkdir()
        for file, text in _HOLD.items():
            (hold / file).write_text(text, "ascii")
        for file, content in carried.items():
            (folder / file).write_bytes(content)
        made = FmuBuilder.build_FMU(
            script,
            dest=folder / "made",
            project_files=[hold, *(folder / file for file in carried)],
            needsExecutionTool="true",
            canHandleVariableCommunicationStepSize="false",
        )
        shutil.move(made, out)
