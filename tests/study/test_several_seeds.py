"""`snapo solve CASE --seeds N`: a training for each seed, a table, and the whole run of the best."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.miniatures import MINIATURES

from snapo.case.error import CaseError
from snapo.cli.answers import by_seed
from snapo.cli.main import main
from snapo.problem.scenarios import EVALUATE, Pseudo, Supplied, stream
from snapo.report.folder import RunResult
from snapo.solver.evaluate import evaluate
from snapo.solver.limits import LimitFound, best_first
from snapo.solver.solution import Solution
from snapo.study import commands, run_folder
from snapo.study import seeds as table_of
from snapo.study.domain import Options
from snapo.testing.miniature import once, quiet

SMALL = MINIATURES["inventory"]


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """A case, and its run with the seeds 0 and 4."""
    folder = tmp_path_factory.mktemp("seeds")
    return once(folder / "two", lambda each: SMALL.solve(each, seeds=(0, 4)))


@pytest.fixture
def run(two, tmp_path):
    return Path(shutil.copytree(two / "run", tmp_path / "run"))


def result_of(run: Path) -> dict:
    return json.loads((run / "result.json").read_text())


def test_the_run_is_that_of_the_best(two, tmp_path, without_page):
    """Its numbers are those of the same case with that seed alone, on paths of that seed."""
    run = two / "run"
    result = result_of(run)
    found = result["seeds"]
    values = {row["seed"]: row["value"] for row in found["rows"]}
    assert list(values) == [0, 4] and found["best"] == max(values, key=lambda seed: values[seed])
    assert result["status"] == "trained" and result["seed"] == found["best"]
    best = result_of(run / "seeds" / str(found["best"]))
    assert result["value"] == best["value"]
    asked = SMALL.request(two)
    more = (*asked.assignments, f"training.seed={found['best']}")
    alone = commands.solve(asked._replace(assignments=more), quiet, out=tmp_path / "alone")
    assert alone["value"] == result["value"]
    assert alone["standard_error"] == result["standard_error"]
    record = run_folder.read(run)
    assert record["decides"] == run_folder.read(tmp_path / "alone")["decides"]
    assert {each["state"] for each in record["parts"].values()} == {"done"}


def test_values_are_compared_on_paths_of_their_own(two):
    """They are neither those of training nor those of the value, and the same for all seeds."""
    loaded = commands.load(SMALL.request(two))
    setup = loaded.domain.study(loaded.case, Options()).setup
    assert setup is not None
    problem = setup().problem
    others = Pseudo(0, stream=stream(EVALUATE, table_of.STREAM))
    assert problem.sources.evaluation != others
    problem = replace(problem, sources=replace(problem.sources, evaluation=others))
    found = result_of(two / "run")["seeds"]
    assert found["fresh"] and found["paths"] == 256
    for row in found["rows"]:
        policy = Solution.load(two / "run" / row["run"], like=setup().policy).policy
        assert policy is not None
        value = evaluate(problem, policy, paths=256, engine=setup().engines.evaluate)
        assert row["value"] == pytest.approx(value.value, rel=1e-9)
        assert row["standard_error"] == pytest.approx(value.standard_error, rel=1e-6)
    low, high = sorted(found["rows"], key=lambda row: row["value"])
    assert low["below_best"] == pytest.approx(high["value"] - low["value"], rel=1e-6)
    assert low["below_best_error"] < low["standard_error"]  # paired


@pytest.mark.prove
def test_the_table_is_kept_printed_and_shown(two, run, capsys):
    result = result_of(run)
    found = result["seeds"]
    values = [row["value"] for row in found["rows"]]
    assert found["mean"] == pytest.approx(np.mean(values))
    assert found["deviation"] == pytest.approx(np.std(values, ddof=1))
    assert (found["worst"], found["highest"]) == (min(values), max(values))
    lines = (run / "seeds.csv").read_text().splitlines()
    assert lines[0].startswith("seed,value,standard_error") and len(lines) == 3
    assert "from other paths, which were not used for this choice" in result["notes"][0]
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "Between seeds" in page and "on other paths" in page
    assert commands.report(run / "seeds" / "0").exists()
    line = ["solve", str(two / "case"), "--out", str(run), "--seeds", "0,4", "--resume"]
    assert main([*line, *[part for each in SMALL.assignments for part in ("--set", each)]]) == 0
    printed = capsys.readouterr().out
    assert "standard deviation between seeds" in printed and "the best" in printed


def test_more_seeds_are_added_and_none_is_trained_again(two, run, without_page):
    said = []
    again = commands.solve(SMALL.request(two), said.append, out=run, resume=True, seeds=(0, 4, 5))
    rows = [row["seed"] for row in again["seeds"]["rows"]]
    assert rows == [0, 4, 5] and again["seed"] == again["seeds"]["best"]
    trained = [line for line in said if line.endswith(": training")]
    assert trained == ["seed 5: training"]
    assert result_of(run)["seeds"] == again["seeds"]


def test_the_other_parts_of_a_seed_can_be_done(two, run, without_page):
    """As its own run, with the value that it has."""
    asked, out = SMALL.request(two), run / "seeds" / "0"
    before, more = result_of(out), (*asked.assignments, "training.seed=0")
    again = commands.solve(asked._replace(assignments=more), quiet, out=out, resume=True)
    assert again["value"] == before["value"]
    assert {"training", "certificate"} <= set(run_folder.read(out)["parts"])


def test_seeds_are_counted_from_that_of_the_case_and_an_interrupted_call_goes_on(
    two, tmp_path, without_page
):
    """Killed in the second training: the first is not done again."""
    asked = SMALL.request(two)
    asked = asked._replace(assignments=(*asked.assignments, "training.seed=7"))

    def stop(text):
        if text == "seed 8: training":
            raise KeyboardInterrupt

    out = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        commands.solve(asked, stop, out=out, seeds=2)
    assert not (out / "run.json").exists() and result_of(out / "seeds" / "7")["value"]
    said = []
    result = commands.solve(asked, said.append, out=out, seeds=2, resume=True)
    assert [row["seed"] for row in result["seeds"]["rows"]] == [7, 8]
    assert "seed 8: training" in said and "seed 7: training" not in said


@pytest.mark.prove
def test_every_seed_begins_with_a_given_policy(two, run, without_page):
    """The policy of the folder that is written to, twice; then resumed."""
    asked = SMALL.request(two)
    before = result_of(run)
    for resume in (False, True):
        result = commands.solve(asked, quiet, out=run, seeds=(0, 4), policy=run, resume=resume)
        assert result["status"] == "trained"
        for seed in (0, 4):
            start = run_folder.read_table(run / "seeds" / str(seed) / "parts" / "given-policy.json")
            assert start and start["began_with"]["value"] == before["value"]
        assert "began with the policy" in " ".join(result["notes"])


def test_a_run_of_another_case_is_not_taken_for_one_of_the_seeds(two, run):
    asked = SMALL.request(two)
    asked = asked._replace(assignments=(*asked.assignments, "training.steps=5"))
    shutil.rmtree(run / "seeds")
    with pytest.raises(CaseError, match=r"training.steps = 4, and now it is 5"):
        commands.solve(asked, quiet, out=run, resume=True, seeds=(0, 4))


def test_a_case_that_trains_nothing_is_refused(tmp_path):
    asked = MINIATURES["pharma"].write(tmp_path)
    with pytest.raises(CaseError, match=r"--seeds: .*trains no policy"):
        commands.solve(asked, quiet, out=tmp_path / "new", seeds=2)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("given", ["0", "-1", "a", "1,", "2,2", "1.5"])
def test_wrong_seeds_are_refused(given, capsys):
    with pytest.raises(SystemExit) as refused:
        main(["solve", "mine", f"--seeds={given}"])
    assert refused.value.code == 2
    assert "--seeds" in capsys.readouterr().err


# Which is the best, and what cannot be known.


def run_of(spent: float, met: str, multiplier: float | None) -> RunResult:
    """A run with a limit of 6 on the spending."""
    limit = LimitFound("spent", 6.0, spent, 0.1, spent, spent, 0.0, 0.0, 0.5, met)
    return RunResult.of({"limits": [limit._asdict() | {"multiplier": multiplier}]})


def test_seeds_within_limits_come_first_and_violations_are_priced():
    within, beyond = run_of(6.0, "met nearly", 0.5), run_of(8.0, "not met", 0.5)
    far, failed = run_of(20.0, "not met", 0.1), run_of(7.0, "not met", None)
    values = [(np.nan, failed), (2.5, far), (3.0, beyond), (1.0, within)]
    found = [table_of._contender(*item) for item in values]
    assert [item.within for item in found] == [False, False, False, True]
    assert best_first(found) == [3, 2, 1, 0]


def test_without_other_paths_the_choice_is_told(two):
    loaded = commands.load(SMALL.request(two))
    setup = loaded.domain.study(loaded.case, Options()).setup
    assert setup is not None
    problem, noise = setup().problem, setup().problem.simulator
    paths = Supplied(np.zeros((noise.horizon, 8, noise.noise_size)))
    sources = replace(problem.sources, evaluation=paths)
    own = setup()._replace(problem=replace(problem, sources=sources))
    assert table_of._measured_on_others(own)[1] is False
    found = result_of(two / "run")["seeds"] | {"fresh": False}
    assert "biased slightly upwards" in table_of.describe(found)


def test_seeds_without_a_value_are_told():
    row = dict.fromkeys(table_of.SeedRow._fields) | {
        "seed": 3,
        "seconds": 1.0,
        "status": "diverged",
    }
    found = dict.fromkeys(table_of.SeedComparison._fields) | {"rows": [row], "best": 3, "paths": 4}
    assert "none" in "\n".join(by_seed(found)) and "diverged" in by_seed(found)[1]
    assert "Best of 1 seeds" in table_of.describe(found)
