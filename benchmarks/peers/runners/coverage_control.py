"""CoverageControl: two robots over a field of 256 x 256 cells, C++ called from Python.

The package's Python side imports torch, torchvision and torch_geometric, which it does not ask pip for and which
its simulator does not use: the compiled core is loaded alone.
"""

import importlib.util
from functools import partial
from importlib.metadata import version
from itertools import cycle
from pathlib import Path
from types import ModuleType

import numpy as np

from runners.clock import Step, Variant, run

SEED = 1
ACTIONS = 256
ROBOTS = 2
CELLS = 256
PEAKS = 8
STARTS = ((96.0, 128.0), (160.0, 128.0))


def _core() -> ModuleType:
    package = importlib.util.find_spec("coverage_control")
    if package is None or not package.submodule_search_locations:
        raise ImportError("coverage_control is not installed")
    (binary,) = Path(package.submodule_search_locations[0]).glob("_core.*.so")
    spec = importlib.util.spec_from_file_location("_core", binary)
    if spec is None or spec.loader is None:
        raise ImportError("coverage_control has no core that can be loaded")
    core = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(core)
    return core


def swarm(objective: bool) -> Step:
    """Return a step with random velocities and, optionally, the objective; without episodes nothing restarts."""
    core = _core()
    parameters = core.Parameters()
    parameters.pNumRobots = ROBOTS
    parameters.pWorldMapSize = parameters.pRobotMapSize = parameters.pLocalMapSize = CELLS
    rng = np.random.default_rng(SEED)
    peaks = [
        core.BivariateNormalDistribution(rng.uniform(0.0, CELLS, 2), 40.0, 1.0)
        for _ in range(PEAKS)
    ]
    # otherwise the package draws a new world each time
    starts = core.PointVector([np.array(start) for start in STARTS])
    system = core.CoverageSystem(parameters, core.BNDVector(peaks), starts)
    drawn = rng.uniform(-1.0, 1.0, (ACTIONS, ROBOTS, 2))
    drawn -= drawn.mean(axis=0)  # otherwise the robots end in a corner with less work
    actions = cycle([core.PointVector(list(row)) for row in drawn])
    if not objective:
        return lambda: system.StepActions(next(actions))

    def step() -> None:
        system.StepActions(next(actions))
        system.GetObjectiveValue()

    return step


if __name__ == "__main__":
    robots = partial(Variant, worlds=1, agents=ROBOTS, field=True)
    run(
        "CoverageControl",
        version("coverage_control"),
        [
            robots(name="step", make=partial(swarm, False)),
            robots(name="step + objective", make=partial(swarm, True)),
        ],
    )
