"""`outrider fmu` with third-party programs: fmpy validates and simulates the units, and drives them with a run.

fmpy and pythonfmu3 live in an environment of their own, `.venv-fmi`, with Outrider installed as a user installs it. The
first call creates it; later calls take half a minute: make bridge-test ARGS=fmi
"""

import json
import os
import re
import shutil
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bridge_checks import ROOT, Row, called, environment, json_of, output, outrider, report

FOREIGN = Path(__file__).resolve().parent / "foreign"

NEEDED = ("fmpy>=0.3.32,<0.4", "pythonfmu3>=0.3.4,<0.4")
FLIGHT = ("escort", "--duration", 60, "--seed", 3)
"""Arguments of all units and runs."""
CRASHES = {
    "raises in a step": ("raise RuntimeError('the wheel is off')", "the wheel is off"),
    "dies in a step": ("import os; os.kill(os.getpid(), 11)", "signal 11"),
}


def flown(*words: object) -> dict[str, Any]:
    """Return the summary of a run."""
    return json_of("run", *FLIGHT, "--no-picture", "--json", *words)


def from_outside(folder: Path, python: Path) -> Iterator[Row]:
    """Check our units with fmpy as their master."""
    for what in ("uav", "ugv", "world"):
        output(*outrider("fmu", "export", what, *FLIGHT, "--out", folder / f"{what}.fmu"))
    (folder / "master").mkdir()
    # fmpy leaves a folder when a step is refused
    environ = os.environ | {"TMPDIR": str(folder / "master")}
    lines = output(python, FOREIGN / "fmi_master.py", folder, env=environ).splitlines()
    found = json.loads(lines[-1])
    wrong = {name: problems for name, problems in found["problems"].items() if problems}
    yield Row(
        "fmpy validates the units of UAV, UGV and world", f"problems: {wrong or 'none'}", not wrong
    )
    rows = found["world"].pop("rows")
    differ = {column: count for column, count in found["world"].items() if count}
    good = not differ and rows == 1201
    yield Row("fmpy simulates the world: the bits of trajectory.csv",
              f"{rows} rows of {len(found['world'])} columns, differ: {differ or 'none'}", good)  # fmt: skip
    for name in ("uav", "ugv"):
        one = found[name]
        certified = "" if one["certified"] is None else f", certified at {one['certified']}"
        yield Row(f"fmpy gives the {name}'s unit what it perceived: it answers what was flown",
                  f"{one['rows'] - 1} steps, at most {one['differ']:.2g} m/s² off{certified}",
                  one["differ"] <= 1e-15 and one["rows"] == 1201)  # fmt: skip
    why = [line for line in lines if "allowed: steps of 0.05 s" in line]
    yield Row(
        "a step of 0.1 s is refused",
        f"{found['refused']}; {why[-1:]}",
        bool(found["refused"] and why),
    )


def from_c(folder: Path, python: Path) -> Iterator[Row]:
    """Check the world's unit with a master in C, which must load a Python for it."""
    what = "a master in C simulates the world: it ends where the run ends"
    code = (
        "from sysconfig import *; "
        "print(*map(get_config_var, ('LIBDIR', 'LDLIBRARY')), get_path('purelib'), sep='\\n')"
    )
    where, name, packages = called(python, "-c", code).stdout.splitlines()
    libpython, compiler = Path(where, name), shutil.which("cc")
    if compiler is None or libpython.suffix != ".so" or not libpython.exists():
        yield Row(what, f"not tried: C compiler {compiler}, Python's library {libpython}", True)
        return
    made = called(compiler, "-o", folder / "master_in_c", FOREIGN / "fmi_master.c", "-ldl")
    with zipfile.ZipFile(folder / "world.fmu") as unit:
        unit.extractall(folder / "unzipped")
    token = re.findall(
        'instantiationToken="(.*?)"', (folder / "unzipped" / "modelDescription.xml").read_text()
    )
    environ = os.environ | {"PYTHONPATH": f"{packages}:{ROOT}:{ROOT / 'extensions'}"}
    done = called(
        folder / "master_in_c", folder / "unzipped", *token, libpython, 1200, 0.05, env=environ
    )
    (header, *_, last) = (folder / "flight" / "trajectory.csv").read_text().splitlines()
    ends = dict(zip(header.split(","), last.split(","), strict=True))
    there = [
        float(ends[f"{vehicle}.{axis} [m]"]) for vehicle in ("uav_0", "ugv_0") for axis in "xy"
    ]
    same = [float(word) for word in done.stdout.split()] == there
    value = f"{done.stdout.strip()}; exit code {done.returncode}{made.stderr}{done.stderr}"
    yield Row(what, value, same and done.returncode == 0)


def driving(folder: Path, python: Path, here: str) -> Iterator[Row]:
    """Check units that drive: one of ours, and one written with plain pythonfmu3."""
    driver = ("--no-files", "--driver", f"fmu:{folder / 'ugv.fmu'}")
    for where, words in (("three processes", ()), ("one process", ("--in-process",))):
        summary = flown(*driver, *words)
        same = summary["trajectory_sha256"] == here
        value = f"{summary['trajectory_sha256'][:16]}, {summary['ticks_per_second']:.0f} ticks/s"
        yield Row(f"the UGV's unit drives, {where}: the bits of the built-in driver", value, same)
    script = (FOREIGN / "fmi_wheel.py").read_text()
    unit = built(python, folder / "theirs", script)
    summary = flown("--out", folder / "driven", "--driver", f"fmu:{unit}")
    kept = summary["visibility_violations"] == 0 and summary["certificate_broken"] == 0
    yield Row(
        "a unit of plain pythonfmu3 drives: sight kept",
        f"at most {summary['max_distance']:.2f} m",
        kept,
    )
    last = (folder / "driven" / "trajectory.csv").read_text().splitlines()
    header, ends = last[0].split(","), (last[1].split(","), last[-1].split(","))
    x, y = header.index("ugv_0.x [m]"), header.index("ugv_0.y [m]")
    (x_0, y_0), (x_1, y_1) = ((float(row[x]), float(row[y])) for row in ends)
    distance = ((x_1 - x_0) ** 2 + (y_1 - y_0) ** 2) ** 0.5
    yield Row("and the UGV has driven its route", f"{distance:.2f} m in 60 s", distance > 5.0)


def crashed(folder: Path, python: Path) -> Iterator[Row]:
    """Check units that fail in a step; a killed process leaves its temporary folder."""
    script = (FOREIGN / "fmi_wheel.py").read_text()
    for what, (line, word) in CRASHES.items():
        bad = script.replace('"""Advance by one step."""', f"if current_time > 5.0: {line}")
        name = f"wheel_{what.split()[0]}"  # Python identifies a module by its name
        unit = built(python, folder / name, bad, name)
        done = called(*outrider("run", *FLIGHT, "--no-files", "--driver", f"fmu:{unit}"))
        lines = [one for one in done.stderr.splitlines() if word in one]
        yield Row(f"one that {what}", lines[-1:], bool(done.returncode and lines))


def built(python: Path, folder: Path, script: str, name: str = "fmi_wheel") -> Path:
    """Build a unit with pythonfmu3 from a script."""
    folder.mkdir()
    (folder / f"{name}.py").write_text(script)
    output(python, "-m", "pythonfmu3", "build", "-f", f"{name}.py", cwd=folder)
    return folder / "Wheel.fmu"


def findings(folder: Path) -> Iterator[Row]:
    """Run all checks; afterwards the folder for temporary files must be empty."""
    python = environment("fmi", (*NEEDED, "--editable", ROOT)) / "python"
    (folder / "tmp").mkdir()
    os.environ["TMPDIR"] = str(folder / "tmp")
    here = flown("--in-process", "--out", folder / "flight")["trajectory_sha256"]
    yield from from_outside(folder, python)
    yield from from_c(folder, python)
    yield from driving(folder, python, here)
    left = sorted(os.listdir(os.environ["TMPDIR"]))
    yield Row("left behind", left or "nothing", not left)
    yield from crashed(folder, python)


if __name__ == "__main__":
    sys.exit(report(findings, __doc__))
