"""The suite: every task can be flown, the score follows its definition, and losing sight never pays."""

import json
import math
from typing import Any

import numpy as np
import pytest

from bus.messages.vehicle import Command
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.closed_loop.pilots import pilot_names
from outrider.envs import worlds
from outrider.envs.vector import OutriderVectorEnv
from outrider.running.flying import InProcess, make_pilots, run
from outrider_learning.suite.board import BASELINES, leaderboard, middle_cell
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.scoring import Team
from outrider_learning.suite.tasks import SEEDS, TASKS, Suite, Task, suite
from refusals import refused
from sim.compiling.compile import FloatArray
from sim.engine.briefing import briefing
from sim.engine.run_keys import derive_secret
from sim.engine.world_state import first_coverage
from sim.models.field import coverage_error
from sim.scenario.checks import scenario_warnings
from sim.server.flight import Flight
from tabular import words
from worlds import SCENARIOS

SECRET = bytes(range(16)).hex()
SHORT = {"duration": 4.0, "area.width": 16.0, "area.height": 12.0, "ugv.0.goals": [[12.0, 9.0]]}
CERTIFICATES = ("certified_while_lost", "certificate_broken")
TASK = Task(name="short", hard="it is over soon", changes=SHORT)
SLOW = Task(name="slow", hard="", changes={**SHORT, "duration": 30.0})


def hover(seen: np.ndarray) -> np.ndarray:
    """Fly to the estimated position of the UGV."""
    return -0.2 * seen[:, 6:8] - seen[:, 3:5]


def away(seen: np.ndarray) -> np.ndarray:
    return np.tile([0.3, 0.3], (len(seen), 1))


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_every_ranked_law_can_fly_each_task(task: Task) -> None:
    scenario = task.scenario
    warnings = [line for line in scenario_warnings(scenario) if "min_separation" not in line]
    assert not warnings
    assert scenario.name == task.name
    assert scenario.title == task.hard
    for uav in scenario.uav:
        assert set(BASELINES) <= set(pilot_names(scenario, uav.name))
        assert briefing(scenario, uav.name, 0).safety.max_measurement_error is not None
    env = task.make(2)
    assert isinstance(env, OutriderVectorEnv)
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros((2, 2)))
    env.close()


def test_there_are_a_dozen_tasks_and_each_has_a_name_of_its_own() -> None:
    assert len(suite()) >= 12
    assert len(set(suite().names)) == len(suite())
    assert suite()["noise"].name == "noise"
    assert suite()[:2].names == suite().names[:2]
    assert suite()[-1] is TASKS[-1]
    with pytest.raises(ValueError, match="task = 'nosie': unknown task; allowed: paper,"):
        suite()["nosie"]


def test_twenty_seeds_differ_from_all_training_seeds() -> None:
    assert len(set(SEEDS)) == 20
    firsts = {task.scenario.seed for task in TASKS}
    assert all(abs(seed - first) > 4096 for seed in SEEDS for first in firsts)


def test_the_score_is_the_mean_share_of_what_there_was_to_see() -> None:
    """Compare with a single flight in the loop of the bus, tick by tick."""
    half = {"coverage.covered": [{"lower": [0.0, 0.0], "upper": [8.0, 12.0]}]}
    task = Task(name="half", hard="", changes=SHORT | half)
    scenario = task.scenario
    own = derive_secret(SECRET, task.name)
    flight = Flight(scenario, 9001, secret=own)
    flight.fly(InProcess(make_pilots(scenario, 9001, secret=own)))
    errors = flight.recorder.escorts[:, 0, 1]
    places = flight.recorder.states[:, flight.world.escorts[0, 1], :2].tolist()
    r_o = scenario.visibility.radius + scenario.sensor.range
    nothing = first_coverage(scenario)
    desired, cell = scenario.coverage.desired, scenario.area.cell
    most = np.array([coverage_error(nothing, x, y, r_o, desired, cell) for x, y in places])
    result = evaluate(task, "certified", seeds=[9000, 9001], secret=SECRET)
    assert result.scores[1] == pytest.approx(100.0 * np.mean(1.0 - errors / most), rel=1e-12)
    assert 0.0 < result.scores[1] < 100.0
    assert result.lost == result.certified_while_lost == result.certificate_broken == 0


def test_the_mean_error_is_that_of_single_runs() -> None:
    result = TASK.evaluate("certified", seeds=[9000, 9001], secret=SECRET)
    own = derive_secret(SECRET, TASK.name)
    alone = [run(TASK.scenario, seed=seed, secret=own).mean_error for seed in (9000, 9001)]
    assert result.mean_error == pytest.approx(np.mean(alone))


def test_external_actions_of_a_law_get_the_score_of_the_law() -> None:
    """Score the recorded commands of a law, given as actions."""
    recorded_actions: list[tuple[float, float]] = []

    class Recording(InProcess):
        def collect(self, tick: int) -> dict[str, Command]:
            commands = super().collect(tick)
            recorded_actions.append(commands["uav_0"].acceleration)
            return commands

    own = derive_secret(SECRET, TASK.name)
    flight = Flight(TASK.scenario, 9003, secret=own)
    flight.fly(Recording(make_pilots(TASK.scenario, 9003, secret=own)))
    commands = iter(recorded_actions)
    outside = TASK.evaluate(lambda seen: [next(commands)], seeds=[9003], secret=SECRET)
    assert outside.scores == TASK.evaluate("certified", seeds=[9003], secret=SECRET).scores


def test_nothing_counts_as_seen_after_sight_is_lost() -> None:
    twins = {"seeds": [9000, 9001]}
    lost, kept = (SLOW.evaluate(entry, **twins, secret=SECRET) for entry in (away, "tracking"))
    assert (lost.lost, kept.lost) == (2, 0)
    longer = Task(name="longer", hard="", changes={**SHORT, "duration": 60.0})
    shorter = longer.evaluate(away, **twins, secret=SECRET)
    # Twice the time with the same flight: the visible part counts half.
    assert np.array(shorter.scores) * 1201 == pytest.approx(np.array(lost.scores) * 601, rel=1e-12)
    assert lost.score < kept.score
    saved = SLOW.evaluate(away, seeds=[9000, 9001], safety_filter=True)
    assert saved.lost == 0
    assert saved.score > lost.score


def test_sight_that_is_found_again_stays_lost() -> None:
    def scores(turns_back: bool) -> tuple[float, ...]:
        def policy(seen: np.ndarray) -> np.ndarray:
            """Fly world 0 out of sight, and back again or not; keep world 1 in place."""
            outward = 0.3 if seen[0, 0] < 14.0 or not turns_back else -0.3
            return np.vstack([[outward, 0.0], hover(seen)[1]])

        result = SLOW.evaluate(policy, seeds=[1, 2], secret=SECRET, estimate=True)
        assert result.lost == 1
        return result.scores

    assert scores(turns_back=True) == scores(turns_back=False)


def test_score_reports_certified_ticks_out_of_sight(monkeypatch):
    class Near(ClosedLoop):
        """End sight at two metres, with another r_v in the safety filter."""

        def begin(self, seeds: Any, worlds: Any = None) -> None:
            self.tables.batch.world["r_v"] = 2.0
            super().begin(seeds, worlds)

    assert SLOW.evaluate("certified", seeds=[9000], secret=SECRET).certified_while_lost == 0
    monkeypatch.setattr(worlds, "ClosedLoop", Near)
    result = SLOW.evaluate("certified", seeds=[9000], secret=SECRET)
    # the tick with which sight is lost ends the task
    assert (result.lost, result.certified_while_lost) == (1, 1)
    result = SLOW.evaluate("certified", seeds=[9000, 9001], secret=SECRET)
    assert (result.lost, result.certified_while_lost) == (2, 2)
    board = leaderboard(["certified", "linear"], tasks=[SLOW], seeds=[9000, 9001], secret=SECRET)
    counts = {standing.entry: standing.certified_while_lost for standing in board.standings}
    assert counts == {"certified": 2, "linear": 0}


def test_score_reports_a_certificate_ended_without_reason(monkeypatch):
    class Impatient(ClosedLoop):
        """Declare a smaller age to the safety filter than its detections have."""

        def begin(self, seeds: Any, worlds: Any = None) -> None:
            assert self.pilots is not None
            self.pilots.tables.uavs.safety["max_age_ticks"] = 0
            super().begin(seeds, worlds)

    monkeypatch.setattr(worlds, "ClosedLoop", Impatient)
    board = leaderboard(["certified", "linear"], tasks=[TASK], seeds=[9000], secret=SECRET)
    counts = {standing.entry: standing.certificate_broken for standing in board.standings}
    assert counts["certified"] > counts["linear"] == 0
    for standing in board.standings:
        assert standing.results[0].certificate_broken == counts[standing.entry]


def test_suite_on_bad_links_has_no_false_certificate() -> None:
    for name in ("late-looks", "dropouts", "bursts", "late-commands", "all-at-once"):
        task = Task(name=name, hard="", changes={**suite()[name].changes, "duration": 80.0})
        result = task.evaluate("certified", seeds=SEEDS[:3])
        assert (result.certified_while_lost, result.certificate_broken) == (0, 0), name


def test_who_sees_more_scores_more() -> None:
    scores = [SLOW.evaluate(law, seeds=[9000, 9001]) for law in ("tracking", "logarithmic")]
    assert scores[0].mean_error > scores[1].mean_error
    assert scores[0].score < scores[1].score


def test_policy_memory_is_per_uav_and_starts_empty() -> None:
    class Counting:
        def __init__(self) -> None:
            self.times: list[float] = []

        def __call__(self, seen: np.ndarray) -> np.ndarray:
            assert seen.shape == (2, 9)
            self.times.append(float(seen[0, 0]))
            assert len(self.times) == len(set(self.times))
            return np.zeros((2, 2))

    policy = Counting()
    pair = Task(name="pair", hard="", changes={**suite()["two-pairs"].changes, "duration": 1.0})
    first, again = (pair.evaluate(policy, seeds=[1, 2], secret=SECRET) for _ in range(2))
    assert first == again
    assert policy.times == []
    assert first.entry == "Counting"


def test_noise_of_an_evaluation_is_secret_until_its_end() -> None:
    first, again = (TASK.evaluate("tracking", seeds=[1, 2]) for _ in range(2))
    assert len({first.secret, again.secret, ""}) == 3
    assert first.scores != again.scores
    assert TASK.evaluate("tracking", seeds=[1, 2], secret=first.secret) == first


def test_both_pairs_count() -> None:
    """Check that one UAV of two that flies away ends the task for both."""
    pair = Task(name="pair", hard="", changes={**suite()["two-pairs"].changes, "duration": 25.0})
    turn = iter(range(10**9))

    def one_goes(seen: np.ndarray) -> np.ndarray:
        return away(seen) if next(turn) % 2 else hover(seen)

    assert pair.evaluate(one_goes, seeds=[1], estimate=True).lost == 1
    assert pair.evaluate(hover, seeds=[1], estimate=True).lost == 0


def test_an_evaluation_is_the_same_again_and_from_another_thread() -> None:
    tasks = [TASK, SLOW]
    entries: dict[str, Any] = {"tracking": "tracking", "mine": hover}
    common = {"tasks": tasks, "seeds": [5, 6], "estimate": True}
    board = leaderboard(entries, **common)  # reuses the secret
    assert board == leaderboard(entries, **common, secret=board.secret)
    for standing in board.standings:
        mine = standing.entry == "mine"
        settings = {"seeds": [5, 6], "secret": board.secret, "name": standing.entry}
        settings |= {"estimate": True} if mine else {}
        entry = hover if mine else "tracking"
        assert standing.results[1] == SLOW.evaluate(entry, **settings)
        mean = np.mean([result.score for result in standing.results])
        assert standing.score == pytest.approx(mean)


def test_the_board_has_the_best_first_and_says_who_lost_sight() -> None:
    shares: list[float] = []
    board = leaderboard(
        {"gone": away, "hover": hover, "linear": "linear"},
        tasks=[SLOW],
        seeds=[5, 6],
        on_progress=lambda what, share: shares.append(share),
    )
    assert [standing.entry for standing in board.standings][-1] == "gone"
    assert shares == pytest.approx([1 / 3, 2 / 3, 1.0])
    lines = board.markdown().splitlines()
    assert lines[1] == "| --- | ---: | ---: | ---: |"
    assert lines[2].startswith("| slow | ")
    assert lines[2].endswith("(2 lost) |")
    assert lines[3].startswith("| **mean** | ")


def test_a_single_seed_has_no_interval() -> None:
    board = leaderboard(["tracking"], tasks=[TASK], seeds=[5], secret=SECRET)
    (standing,) = board.standings
    bounds = (standing.low, standing.high, standing.middle_low, standing.results[0].high)
    assert all(map(math.isnan, bounds))
    assert [line.split(" | ")[1] for line in board.markdown().splitlines()[2:]] == [
        f"{standing.score:.1f} |"
    ] * 2
    assert middle_cell(standing) == f"{standing.score:.1f}"


@pytest.mark.parametrize(
    ("entry", "settings", "message"),
    [
        ("lograithmic", {}, "law = 'lograithmic': unknown law; allowed: tracking,"),
        ("linear", {"estimate": True}, "estimate: not supported for the law"),
        (
            hover,
            {"duration": 1.0},
            "duration: fixed by the task; allowed: estimate,",
        ),
        (lambda seen: np.zeros(3), {}, r"actions of uav_0: an array of shape \(3,\)"),
    ],
    ids=["law", "setting of a law", "setting of the task", "no action"],
)
def test_what_cannot_be_scored_is_refused_in_one_line(entry, settings, message):
    with refused(ValueError, message):
        TASK.evaluate(entry, seeds=[1, 2], **settings)


@pytest.mark.parametrize(
    ("seeds", "message"),
    [([], "seeds: empty"), ([1, -1], "seed = -1"), ([1.5], "seed = 1.5")],
)
def test_bad_seeds_are_refused(seeds: Any, message: str) -> None:
    for entry in ("tracking", hover):
        with pytest.raises(ValueError, match=message):
            TASK.evaluate(entry, seeds=seeds)


def test_leaderboard_without_entries_is_refused() -> None:
    with pytest.raises(ValueError, match="0 entries and 1 tasks"):
        leaderboard({}, tasks=[TASK])
    with pytest.raises(ValueError, match="2 entries and 0 tasks"):
        leaderboard(["linear", "tracking"], tasks=[])


def test_a_scenario_of_ones_own_is_scored_alike() -> None:
    class Own(Task):
        @property
        def scenario(self) -> Any:
            return SCENARIOS["certified"]

    assert Own(name="own", hard="", changes={}).evaluate("linear", seeds=[1, 2]).task == "own"
    assert Suite([TASK]).names == ("short",)


@pytest.mark.parametrize("base", ["escort", pytest.param("minefield", marks=pytest.mark.long)])
def test_noise_of_one_task_reveals_nothing_about_another(
    base: str,
) -> None:
    """Move all vehicles alike in both tasks, so that detections differ by noise only."""
    mission = base == "minefield"

    def detections_of(name: str) -> FloatArray:
        seen = []

        def act(observations: FloatArray) -> FloatArray:
            seen.append(observations[:, 5:8].copy())
            return np.zeros((len(observations), 2))

        def stand(_observations: Any) -> FloatArray:
            return np.zeros((1, 2))

        changes = {"duration": 4.0, "detections.noise": 0.1, "detections.dropout": 0.0}
        task = Task(name=name, hard="", base=base, changes=changes, mission=mission)
        entry = Team(uav=act, ugv=stand) if mission else act
        task.evaluate(entry, seeds=(9000,), secret=SECRET)
        return np.concatenate(seen)

    one, again, other = detections_of("one"), detections_of("one"), detections_of("other")
    assert np.array_equal(one, again)
    assert one[1:, 0].all()
    assert (one[1:, 1:] != other[1:, 1:]).all()
    assert derive_secret("", "one") == ""


def test_duplicate_tasks_and_invalid_entries_are_refused() -> None:
    with refused(ValueError, "short, slow, short: duplicate name"):
        leaderboard({"mine": hover}, tasks=[TASK, SLOW, TASK])
    with refused(ValueError, "entry = None; allowed: a law by name, a policy or a team"):
        leaderboard({"mine": None}, tasks=[TASK])


def test_the_command_scores_laws_and_policies(here, command) -> None:
    source = "import numpy as np\n\n\ndef away(seen):\n    return np.full((len(seen), 2), 0.3)\n"
    (here / "mine_for_the_suite.py").write_text(source, encoding="utf-8")
    own = words("--uav-policy mine_for_the_suite:away --safety-filter --only short-sight --secret")
    run = command("suite", "--law", "tracking", *own, SECRET, "--json")
    assert (run.returncode, run.stderr) == (0, "")
    result_json = json.loads(run.stdout)
    assert result_json["tasks"] == ["short-sight"]
    assert result_json["secret"] == SECRET
    entries = {standing["entry"] for standing in result_json["standings"]}
    assert entries == {"tracking", "mine_for_the_suite:away"}
    result = result_json["standings"][0]["results"][0]
    names = words("task entry score low high scores mean_error lost episodes secret")
    assert set(result) == {*names, *CERTIFICATES}
    assert result["episodes"] == len(result["scores"]) == 20
    assert all(
        standing["lost"] == 0 for standing in result_json["standings"]
    )  # the safety filter was active
    assert all(
        standing[count] == 0 for standing in result_json["standings"] for count in CERTIFICATES
    )


def test_command_lists_the_tasks(command) -> None:
    tasks = json.loads(command("suite", "--list", "--json").stdout)["tasks"]
    assert [task["name"] for task in tasks] == list(suite().names)
    assert tasks[0]["env_id"] == "outrider/Suite-Paper-v0"
    for more in ("--list", "--list --markdown --law linear"):
        assert "late-commands" in command("suite", *words(more)).stdout
