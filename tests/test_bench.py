"""The bench: C that computes what ours compute, rows without what they need, and the picture of the scaling."""

import importlib
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from processes import python
from worlds import SCENARIOS

from bus.errors import ScenarioError
from bus.extras import EXTRAS
from outrider.bench import kernels, many, runs, scaling
from outrider.bench import measured as rows
from outrider.bench.c_kernels import COMPILERS, CKernels
from outrider.bench.measured import ROWS, measure
from outrider.cli import bench as command
from sim.scenario.loading import load_scenario

SHORT = SCENARIOS["certified"]


@pytest.fixture(scope="module")
def built() -> Any:
    with CKernels.build() as found:
        if found is None:
            pytest.skip("no C compiler")
        yield found


def test_the_c_kernels_compute_what_ours_do(built: CKernels) -> None:
    built.check(300)
    ours, theirs = kernels.ground(), kernels.ground()
    assert built.passes(theirs, 7, lanes=True) == kernels.passes(ours, 7)
    assert built.passes(theirs, 7, lanes=False) == pytest.approx(kernels.passes(ours, 7), rel=1e-12)


@pytest.mark.parametrize("name", ["accumulate", "coverage_error", "coverage_gradient"])
def test_c_kernels_that_compute_something_else_are_no_reference(built, name, monkeypatch):
    from outrider.bench import c_kernels

    def wrong(coverage: np.ndarray, *place: Any) -> Any:
        found = getattr(kernels, name)(coverage, *place)
        coverage[0, 0] += 1e-12 if name == "accumulate" else 0.0
        return (
            None
            if found is None
            else tuple(1.0 + 1e-9 + value for value in found)
            if isinstance(found, tuple)
            else found + 1e-9
        )

    monkeypatch.setattr(c_kernels, name, wrong)
    with pytest.raises(ArithmeticError, match="something else"):
        built.check()


@pytest.mark.parametrize("name", ["kernel_vs_c", "kernel_vs_c_lanes"])
def test_without_a_compiler_the_row_still_comes(name, tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "_PASSES", 10)
    monkeypatch.setenv("PATH", str(tmp_path))
    row = measure([name], 1)[0]
    assert row.value > 0.0
    assert (row.reference_value, row.ratio) == (None, None)
    assert "no C compiler" in row.reference
    broken = tmp_path / COMPILERS[0]
    broken.write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    broken.chmod(0o755)
    assert measure([name], 1)[0].reference_value is None


def test_with_a_compiler_the_row_stands_beside_it(built, monkeypatch):
    monkeypatch.setattr(kernels, "_PASSES", 10)
    row = measure(["kernel_vs_c"], 2)[0]
    assert row.reference == ROWS["kernel_vs_c"].reference
    assert row.reference_value is not None
    assert row.ratio is not None


@pytest.mark.parametrize("paid", [None, many.RATE])
def test_many_worlds_have_a_rate_and_a_limit(paid: Any) -> None:
    rate, limit = many.stepped(SHORT, rewards=paid, worlds=4, steps=4)
    assert rate > 0.0
    assert limit > 0.0
    assert many.stepped(SHORT, rewards=paid, worlds=4, steps=4, limit=False)[1] is None


def test_pilots_and_memory_have_both_numbers() -> None:
    assert min(many.pilots(worlds=4, ticks=3)) > 0.0  # type: ignore[type-var]
    told = "import json; from outrider.bench.many import growth; print(json.dumps(growth(64)))"
    # a process that has memory to spare grows by nothing
    counted, grown = json.loads(python(told).stdout)
    assert counted > 160 * 160 * 8
    assert grown == pytest.approx(counted, rel=0.5)


def test_a_sweep_has_a_rate() -> None:
    rate, limit = runs.sweep(seconds=1.0, seeds=1)
    assert rate > 0.0
    assert limit is not None


def test_a_row_whose_extra_is_missing_is_left_out_unless_it_is_asked_for(monkeypatch):
    layer = rows.Layer(lambda: (2.0, 1.0), "1", "one")
    monkeypatch.setitem(EXTRAS, "tls", ("pyarrow", "no_such_package"))
    monkeypatch.setattr(rows, "ROWS", {"can": layer, "cannot": layer._replace(extra="tls")})
    assert [row.name for row in measure([], 1)] == ["can"]
    with pytest.raises(ScenarioError, match="--only cannot: no_such_package is missing"):
        measure(["cannot"], 1)


def test_the_floor_counts_the_cells_of_a_disc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks"))
    world_step = importlib.import_module("world_step")
    cells, lines = world_step.disc(5.0, 0.25, 40.0)
    y, x = np.mgrid[:160, :160] * 0.25 + 0.125 - 20.0
    assert cells == np.count_nonzero(x * x + y * y <= 25.0)
    assert cells / 8 < lines < cells / 8 + 41
    least = world_step.floor(load_scenario("escort"))
    assert least["cells_density"] > 3 * least["cells_sensor"]
    assert least["bytes_full"] > 8 * least["cells_density"]


def test_the_scaling_is_measured_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "CELLS", (0.5, 0.25))
    monkeypatch.setattr(scaling, "PAIRS", (1, 2))
    path = tmp_path / "deep" / "scaling.png"
    points = scaling.make_scaling(path, seconds=0.001, most=4)
    assert path.read_bytes().startswith(b"\x89PNG")
    told = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert told["points"] == msgspec.to_builtins(points)
    assert {(p.panel, p.value, p.mode) for p in points} == {
        (panel, value, mode)
        for mode in ("full", "rate")
        for panel, values in (("worlds", (1, 4)), ("cells", (0.5, 0.25)), ("pairs", (1, 2)))
        for value in values
    }
    assert all(p.world_steps_per_second > 0.0 for p in points)


def test_the_picture_must_be_a_picture(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"ends in \.png"):
        command.command(scaling=tmp_path / "scaling.pdf")
