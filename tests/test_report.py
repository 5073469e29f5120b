"""Reports: correct intervals, a self-contained page, and one experiment from several folders."""

import json
import math
import re
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="the extra [sweep] is not installed")
from matplotlib.text import Text
from scipy import stats

from bus.errors import ScenarioError
from outrider.experiments.intervals import mean_interval, wilson_interval
from outrider.experiments.report.document import certified_runs, holds, markdown, page
from outrider.experiments.report.plots import ages, draw_all, errors, margins, violations
from outrider.experiments.report.results import Material, read_material
from outrider.experiments.sweep.columns import RESULTS
from outrider.experiments.sweep.definition import describe_sweep
from outrider.experiments.sweep.folder import SweepFolder
from outrider.experiments.sweep.plan import SweepPlan, lay_out


def test_the_wilson_interval_of_none_of_twenty():
    low, high = wilson_interval(0, 20)  # 1 / (1 + 20 / 1.96²)
    assert low == 0.0
    assert high == pytest.approx(0.16113, abs=1e-5)
    for hits, trials in ((0, 0), (-1, 3), (4, 3)):
        with pytest.raises(ValueError, match=f"hits = {hits}"):
            wilson_interval(hits, trials)


def test_the_interval_of_a_mean_is_student_s():
    mean, low, high = mean_interval([4.0, 5.0, 6.0])  # t(2) = 4.303, spread 1
    half = 4.3027 / 3**0.5
    assert (mean, low, high) == pytest.approx((5.0, 5.0 - half, 5.0 + half), abs=1e-4)
    assert mean_interval([3.0, 3.0]) == (3.0, 3.0, 3.0)
    mean, low, high = mean_interval([2.0])
    assert (mean, math.isnan(low), math.isnan(high)) == (2.0, True, True)
    with pytest.raises(ValueError, match="values: empty"):
        mean_interval([])


def plan_of(**given) -> SweepPlan:
    described = {
        "laws": "linear,switching",
        "vary": ["links.detections.delay=0,0.5,1,2"],
        "seeds": 5,
        **given,
    }
    return lay_out(describe_sweep("escort", **described)[0])


def made_up(plan: SweepPlan, run: int) -> dict[str, object]:
    """Return a row: switching breaks from 1 s on except for the first seed; linear breaks once at 2 s, where one run
    failed.
    """
    head = plan.head(run)
    delay, seed = head.get("links.detections.delay") or 0.0, head["seed"]
    if (head["law"], delay, seed) == ("linear", 2.0, 0):
        return {**dict.fromkeys(RESULTS), "run": run, "error": "RuntimeError: made up <b>"}
    lost = head["law"] == "switching" and delay >= 1.0 and seed > 0
    lost = lost or (head["law"], delay, seed) == ("linear", 2.0, 4)
    found = {
        "max_distance": 4.0 + lost + 0.01 * seed,
        "margin": 0.75 - lost - 0.01 * seed,
        "violated": lost,
        "detections_mean_age": delay,
        "detections_max_age": delay + 0.05,
        "detections_delivery_ratio": 0.9,
        "mean_error": 100.0 + 10.0 * delay + seed,
        "trajectory_sha256": f"{head['law']}{delay}{seed}",
    }
    return {**dict.fromkeys(RESULTS), **found, "run": run}


def written_sweep(path: Path, plan: SweepPlan, rows, *, whole: bool = True) -> Path:
    with SweepFolder(path, plan, command=f"outrider sweep --out {path.name}") as folder:
        folder.add(iter(rows))
        if whole:
            folder.finish()
    return path


def swept(path: Path, plan: SweepPlan, **given) -> Path:
    return written_sweep(path, plan, (made_up(plan, run) for run in range(plan.runs)), **given)


@pytest.fixture(scope="module")
def material(tmp_path_factory) -> Material:
    return read_material([swept(tmp_path_factory.mktemp("sweeps") / "delay", plan_of())])


def test_runs_are_counted_where_they_belong(material):
    (panel,) = material.panels
    assert (panel.title, panel.label) == ("delay of the detections", "delay of the detections [s]")
    assert panel.values == [0.0, 0.5, 1.0, 2.0]
    assert panel.laws == list(material.law) == ["linear", "switching"]
    assert (material.rows, material.failed, material.missing) == (40, 1, 0)
    cell = panel.cell("switching", 1.0)
    assert (len(cell.flown), cell.violated, cell.failed) == (5, 4, 0)
    assert cell.rate() == pytest.approx(
        (0.8, *stats.binomtest(4, 5).proportion_ci(method="wilson"))
    )
    last = panel.cell("linear", 2.0)
    assert (len(last.flown), last.violated, last.failed) == (4, 1, 1)  # failed runs are in no rate
    assert cell.numbers("margin") == pytest.approx([0.75, -0.26, -0.27, -0.28, -0.29])
    assert cell.numbers("estimate_rmse") == []
    assert holds(panel, "linear") == ("kept up to 1 s, broken at 2 s", False)
    assert holds(panel, "switching") == ("kept up to 0.5 s, broken at 1 s", False)
    assert holds(panel, "circle") == ("-", False)


def test_unordered_values_are_named_where_the_guarantee_breaks(tmp_path):
    plan = plan_of(laws="linear,switching,circle", vary=["links.profile=wifi,lte,jammed"])
    rows = [made_up(plan, run) for run in range(plan.runs)]
    for run, row in enumerate(rows):
        head = plan.head(run)
        hard = head["law"] == "circle" or (head["law"], head["links.profile"]) == ("linear", "lte")
        row |= {"violated": hard, "error": None}
    material = read_material([written_sweep(tmp_path / "sweep", plan, rows)])
    assert [holds(material.panels[0], law) for law in material.law] == [
        ("broken over lte", False),
        ("kept over each value tried", True),
        ("broken over each", False),
    ]


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_lost_run_without_certificate_breaks_none(share, tmp_path):
    plan = plan_of(laws="linear,certified")
    rows = [made_up(plan, run) for run in range(plan.runs)]
    for run, row in enumerate(rows):
        head = plan.head(run)
        late, seed = (head.get("links.detections.delay") or 0.0) >= 2.0, head["seed"]
        if head["law"] == "certified":
            lies = (4, 1200) if late and seed == 1 else (0, 0)
            row |= {"violated": late and seed == 0, "certified_share": share if late else 1.0}
            row |= dict(zip(("certified_while_lost", "certificate_broken"), lies, strict=True))
    material = read_material([written_sweep(tmp_path / "sweep", plan, rows)])
    where, runs, lost = (", where it is not certified", 15, 0) if share < 1.0 else ("", 20, 1)
    assert holds(material.panels[0], "certified") == (
        f"kept up to 1 s, broken at 2 s{where}",
        False,
    )
    line = f"{runs} runs were certified at every tick; {lost} of them lost sight of the UGV."
    assert certified_runs(material) == line
    table, html = markdown(material), page(material, {}, "outrider report")
    assert f"| {100 * share:g} % | 4 | 1,200 |\n" in table
    assert "| 100 % | 0 | 0 |\n" in table
    assert '<td class="n bad">1,200</td>' in html
    assert '<td class="n">0</td>' in html


def test_the_markdown_table_has_every_value_and_law(material):
    text = markdown(material)
    assert (
        "| delay of the detections | kept up to 1 s, broken at 2 s | kept up to 0.5 s, broken at 1 s |"
        in text
    )
    runs = "| 1 s | switching | 5 | 4 (80 %) | 38 % to 96 % | -0.29 | -0.27 | 112 | 1 | 90 % |"
    assert f"{runs} - | - | - | - |" in text
    assert "| 2 s | linear | 4 (+1 failed) | 1 (25 %) |" in text
    for value in ("0 s", "0.5 s", "1 s", "2 s"):
        for law in ("linear", "switching"):
            assert f"| {value} | {law} |" in text


@pytest.fixture(scope="module")
def pictures(material, tmp_path_factory) -> dict[str, Path]:
    return draw_all(material, tmp_path_factory.mktemp("pictures"))


@pytest.mark.parametrize("draw", [violations, margins, errors, ages])
def test_no_picture_shows_the_source_of_a_formula(material, draw):
    figure = draw(material)
    shown = [text.get_text() for text in figure.findobj(Text)]
    assert len(shown) > 5
    assert not [text for text in shown if r"\$" in text or text.count("$") % 2]


def test_the_page_needs_nothing_beside_itself(material, pictures):
    assert set(pictures) == {"violations", "margins", "errors", "ages"}
    text = page(material, pictures, "outrider report sweeps/delay")
    assert text.count('src="data:image/png;base64,') == 4
    assert not re.search(r"<script|<link|(src|href)=\"(?!data:)|url\(|@import", text)
    phrases = ("outrider sweep --out delay", "outrider report sweeps/delay", "4 (80 %)")
    for wanted in (*phrases, material.heads[0].outrider):
        assert wanted in text
    assert "made up <b>" not in text


def test_folders_of_one_experiment_are_joined(tmp_path):
    laws = [swept(tmp_path / law, plan_of(laws=law)) for law in ("switching", "linear", "circle")]
    more = swept(tmp_path / "more", plan_of(seeds=7))
    (panel,) = read_material([*laws, more]).panels
    assert panel.laws == ["linear", "switching", "circle"]
    assert len(panel.cell("circle", 0.0).flown) == 5
    assert len(panel.cell("switching", 0.0).flown) == 7  # a run of two folders counts once
    other = swept(tmp_path / "other", plan_of(changes=["detections.noise=0.4"]))
    titles = [f"delay of the detections ({folder})" for folder in (more, other)]
    assert [panel.title for panel in read_material([more, other]).panels] == titles


def test_product_has_a_panel_per_value_of_the_smaller_field(tmp_path):
    plan = plan_of(vary=["links.detections.loss=0,0.5", "links.detections.delay=0,0.5,1"], seeds=2)
    panels = read_material([swept(tmp_path / "sweep", plan)]).panels
    titles = [f"loss of the detections {share} %" for share in (0, 50)]
    assert [panel.title for panel in panels] == titles
    assert all(panel.values == [0.0, 0.5, 1.0] for panel in panels)
    assert sum(len(cell.rows) for panel in panels for cell in panel.cells.values()) == plan.runs


def test_a_sweep_of_nothing_words_or_failures_is_drawn(tmp_path):
    nothing = swept(tmp_path / "nothing", plan_of(vary=[], seeds=2))
    words = swept(tmp_path / "words", plan_of(vary=["ugv.0.driver=evade,wander"], seeds=1))
    material = read_material([nothing, words])
    assert [panel.values for panel in material.panels] == [[None], ["evade", "wander"]]
    assert "violations" in draw_all(material, tmp_path)
    assert "| evade | linear |" in markdown(material)
    plan = plan_of(vary=["dt=0.05,0.1"], changes=["detections.rate=10"], seeds=1)
    rows = [{**dict.fromkeys(RESULTS), "run": run, "error": "no"} for run in range(plan.runs)]
    failed = read_material([written_sweep(tmp_path / "failed", plan, rows, whole=False)])
    assert "No run is complete." in page(failed, draw_all(failed, tmp_path), "")


def test_unfinished_sweep_is_marked_and_an_empty_one_refused(tmp_path):
    plan = plan_of()
    rows = (made_up(plan, run) for run in range(12))
    half = written_sweep(tmp_path / "half", plan, rows, whole=False)
    material = read_material([half])
    assert (material.rows, material.missing) == (12, 28)
    assert "Not finished:" in page(material, {}, "")
    with SweepFolder(tmp_path / "empty", plan, command=""):
        pass
    with pytest.raises(ScenarioError, match="no results yet"):
        read_material([tmp_path / "empty"])
    with pytest.raises(ScenarioError, match="not a folder of a sweep"):
        read_material([tmp_path])


def test_report_writes_page_and_pictures_and_prints_json(tmp_path, command):
    folder = swept(tmp_path / "delay", plan_of(seeds=2))
    done = command("report", str(folder), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["rows"], found["failed"], found["missing"]) == (16, 1, 0)
    assert Path(found["page"]) == folder / "report" / "report.html"
    assert all(
        Path(path).read_bytes().startswith(b"\x89PNG") for path in found["pictures"].values()
    )
    again = command("report", str(folder), "--markdown", "--out", str(tmp_path / "elsewhere"))
    assert again.stdout.startswith("| experiment | linear | switching |")
    assert (tmp_path / "elsewhere" / "report.html").exists()
