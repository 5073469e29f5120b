"""The program that `fmi_programs.py` calls: fmpy as the master of exported units, in an environment of its own.

It validates each unit, simulates it, and writes its findings as JSON. It imports nothing of Outrider; the units do.
"""

import csv
import json
import sys
from pathlib import Path

import numpy as np
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

DT = 0.05


def table(file: Path) -> dict[str, list[str]]:
    """Return the columns of a run's trajectory.csv, named without their units."""
    with file.open(newline="") as text:
        header, *rows = csv.reader(text)
    return {name.split(" [")[0]: [row[k] for row in rows] for k, name in enumerate(header)}


def numbers(texts: list[str]) -> np.ndarray:
    """Return a column as numbers; 0 for an empty field."""
    return np.array([float(text or 0.0) for text in texts])


def inputs_of(unit: Path, name: str, flown: dict[str, list[str]]) -> np.ndarray:
    """Return a vehicle's observations in a run as input signals of fmpy."""
    time = numbers(flown["time"])
    known = {f"{what}.{axis}": numbers(flown[f"{name}.{short}{axis}"])
             for what, short in (("position", ""), ("velocity", "v")) for axis in "xy"}  # fmt: skip
    if name.startswith("uav"):
        known["detection.new"] = np.array([text != "" for text in flown[f"{name}.detected_x"]])
        known["detection.time"] = time
        known |= {f"detection.{axis}": numbers(flown[f"{name}.detected_{axis}"]) for axis in "xy"}
    described = read_model_description(str(unit)).modelVariables
    types = [
        (one.name, "?" if one.type == "Boolean" else "f8")
        for one in described
        if one.causality == "input"
    ]
    signals = np.zeros(len(time), dtype=[("time", "f8"), *types])
    signals["time"] = time
    for name_of_input, _ in types:
        signals[name_of_input] = known[name_of_input]
    return signals


def differences(unit: Path, flown: dict[str, list[str]]) -> dict[str, int]:
    """Return the number of values in which the world's unit differs from trajectory.csv, by column."""
    end = float(flown["time"][-1])
    outputs = simulate_fmu(str(unit), stop_time=end, output_interval=DT)
    found: dict[str, int] = {}
    for name in ("uav_0", "ugv_0"):
        for what, short in (("position", ""), ("velocity", "v")):
            for axis in "xy":
                column = f"{name}.{short}{axis}"
                found[column] = int(
                    (outputs[f"{name}.{what}.{axis}"] != numbers(flown[column])).sum()
                )
        for axis in "xy":  # applied in the previous step
            applied = numbers(flown[f"{name}.u{axis}"])[:-1]
            found[f"{name}.u{axis}"] = int(
                (outputs[f"{name}.acceleration.{axis}"][1:] != applied).sum()
            )
    for column in ("distance", "coverage_error"):
        found[column] = int((outputs[f"uav_0.{column}"] != numbers(flown[f"uav_0.{column}"])).sum())
    certified = numbers(flown["uav_0.certified"])[:-1]
    found["certified"] = int((outputs["uav_0.certified"][1:] != certified).sum())
    return found | {"rows": len(outputs)}


def answers(unit: Path, name: str, flown: dict[str, list[str]]) -> dict[str, object]:
    """Compare the outputs of a vehicle's unit, given the vehicle's observations, with the recorded commands."""
    signals = inputs_of(unit, name, flown)
    end = float(flown["time"][-1])
    outputs = simulate_fmu(str(unit), stop_time=end, output_interval=DT, input=signals)
    differ = 0.0
    # the output after step k acts in tick k, shortened to the bound by a last bit
    for axis in "xy":
        applied = numbers(flown[f"{name}.u{axis}"])[:-1]
        differ = max(differ, float(np.abs(outputs[f"acceleration.{axis}"][1:] - applied).max()))
    certified = int(outputs["certified"].sum()) if "certified" in outputs.dtype.names else None
    return {"rows": len(outputs), "differ": differ, "certified": certified}


def refused_step(unit: Path) -> str:
    """Return the error of fmpy for a step of another length."""
    try:
        simulate_fmu(
            str(unit), stop_time=1.0, output_interval=0.1, step_size=0.1, debug_logging=True
        )
    except Exception as error:  # noqa: BLE001 - any error counts
        return str(error)
    return ""


def main() -> None:
    """Check the units and trajectory.csv in a folder, and print JSON."""
    folder = Path(sys.argv[1])
    flown = table(folder / "flight" / "trajectory.csv")
    units = {name: folder / f"{name}.fmu" for name in ("uav", "ugv", "world")}
    print(json.dumps({
        "problems": {name: [str(one) for one in validate_fmu(str(unit))] for name, unit in units.items()},
        "world": differences(units["world"], flown),
        "uav": answers(units["uav"], "uav_0", flown),
        "ugv": answers(units["ugv"], "ugv_0", flown),
        "refused": refused_step(units["world"]),
    }))  # fmt: skip


if __name__ == "__main__":
    main()
