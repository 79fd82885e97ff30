"""The tasks of a book: policies for each stress, further jobs, derivatives, judged contracts,
markets, and cases of their own folders."""

import platform
from dataclasses import replace

import numpy as np
import pytest
from tests.book.books import HERE, write_book
from tests.book.conftest import ROWS
from tests.miniatures import thirty_days

from snapo.book import run, work
from snapo.book.collect import position
from snapo.book.executors import worker_pools
from snapo.book.file import read_book
from snapo.book.folder import BookFolder
from snapo.book.job import (
    STRESSES,
    BookJob,
    BookPoint,
    Cost,
    Delta,
    JobResult,
    enclosed,
    opened,
)
from snapo.book.plan import BookPlan
from snapo.book.run import plan_of, run_book
from snapo.book.work import compute
from snapo.case.error import CaseError
from snapo.engine.workers import OTHER
from snapo.lanes.machine import pipeline

TASKS = "[tasks]\npaths = 512\njudge = 0\nexposure = false\n"
ONE = ROWS[:1]


def points(file, out):
    """{contract: {stress: its point}}."""
    result = run_book(read_book(file), lambda _: None, HERE, out=out)
    assert result["status"] == "ok", result["failures"]
    book, folder = read_book(file), BookFolder(out)
    members = [position(plan_of(book), x, folder, {}) for x in book.contracts]
    return {x.contract.name: {name: p for name, (p, _, _) in x.points.items()} for x in members}


@pytest.mark.prove
def test_a_policy_for_each_stress_is_that_of_the_stressed_case(tmp_path):
    """Trained under a cost of injection that is 0.05 higher: the contract with that cost."""
    stress = '[[stress]]\nname = "dear"\nshift = { "contract.injection_cost" = 0.05 }\n'
    tasks = TASKS + 'policy = "stress"\n'
    file = write_book(tmp_path / "stressed", ONE, stresses=stress, more=tasks)
    stressed = points(file, tmp_path / "a")["first"]["dear"]
    dear = [ONE[0] | {"contract.injection_cost": 0.07}]
    other = points(write_book(tmp_path / "dear", dear, stresses=""), tmp_path / "b")["first"][
        "base"
    ]
    # 0.02 + 0.05 is 0.07 but for rounding.
    assert stressed.value == pytest.approx(other.value, rel=1e-6)
    held = write_book(tmp_path / "held", ONE, stresses=stress)
    assert points(held, tmp_path / "c")["first"]["dear"].value != stressed.value


@pytest.mark.prove
def test_many_stresses_are_further_jobs_of_the_same_policy(tmp_path):
    """One stress alone, and as the last of 27, which is in another job: the same bits."""
    last = '[[stress]]\nname = "last"\nscale = { "market.forward_curve" = 1.2 }\n'
    some = "".join(
        f'[[stress]]\nname = "s{i}"\nscale = {{ "market.forward_curve" = {1 + i / 100} }}\n'
        for i in range(STRESSES + 1)
    )
    alone = points(write_book(tmp_path / "alone", ONE, stresses=last), tmp_path / "a")["first"]
    file = write_book(tmp_path / "many", ONE, stresses=some + last)
    many = points(file, tmp_path / "b")["first"]
    assert plan_of(read_book(file)).size == 2
    assert alone["base"].value == many["base"].value == many["s0"].value
    np.testing.assert_array_equal(alone["last"].shares, many["last"].shares)


def test_a_stress_within_a_period_moves_its_days_alone(tmp_path):
    stress = '[[stress]]\nname = "days"\nshift = { "market.forward_curve" = 2.0 }\n'
    when = 'when = "2025-01-10/2025-01-12"\n'
    point = points(write_book(tmp_path, ONE, stresses=stress + when), tmp_path / "run")["first"]
    moved = point["days"].changes["forward_curve"]
    assert np.count_nonzero(moved) == 3 and set(np.round(moved, 9)) == {0.0, 2.0}


def test_derivatives_of_all_points_or_of_none(tmp_path):
    every = write_book(tmp_path / "all", ONE, more=TASKS + 'deltas = "all"\n')
    for point in points(every, tmp_path / "a")["first"].values():
        assert {"forward_curve", "injection_cost"} <= {x.input for x in point.deltas}
    nothing = write_book(tmp_path / "none", ONE, more=TASKS + 'deltas = "none"\n')
    assert not any(p.deltas for p in points(nothing, tmp_path / "b")["first"].values())


@pytest.mark.parametrize("refuted", [False, True])
def test_a_share_of_the_contracts_is_judged(refuted, tmp_path, monkeypatch):
    """Three of five that are alike, whatever the share; in the others the input that was refuted in
    one of them, and not before that is known."""
    rows = [{"name": f"{i}", "contract.injection_cost": 0.02 + i / 100} for i in range(5)]
    file = write_book(
        tmp_path, rows, stresses="", more="[tasks]\npaths = 512\njudge = 0.1\nexposure = false\n"
    )
    judged = []

    def compute(data):
        job = BookJob.unpack(data)
        judged.append((job.judged, job.bumped))
        trusted = not refuted if job.judged else None
        delta = Delta("injection_cost", ("",), "MWh", np.ones((32, 1)), trusted)
        point = BookPoint("ok", "", 1.0, 0.1, np.ones(512), {}, (delta,))
        return enclosed(JobResult((point,)).pack(), Cost(1.0, 1.0, "here"))

    monkeypatch.setattr(run, "compute", compute)
    assert run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "run")["status"] == "ok"
    others = (False, ("injection_cost",) if refuted else ())
    assert judged == [*3 * [(True, ())], *2 * [others]]
    assert plan_of(read_book(file)).judged == {"0", "1", "2"}
    nobody = BookPlan(read_book(write_book(tmp_path / "b", rows, stresses="", more=TASKS)))
    assert not nobody.judged


@pytest.mark.prove
def test_a_derivative_refuted_in_a_similar_contract_is_tested_and_no_other(tmp_path):
    """The value, the policy and all derivatives are those of a job without bumps, to the bit."""
    more = "[tasks]\npaths = 512\njudge = 0\nexposure = false\n"
    book = read_book(write_book(tmp_path, ONE, stresses="", more=more))
    plain = BookJob.of(book.contracts[0], book.tasks, book.run.seed)
    tested = replace(plain, bumped=("end_inventory", "injection_cost"))
    results = [JobResult.unpack(opened(compute(job.pack()))[0]) for job in (plain, tested)]
    first, second = results
    assert first.policy == second.policy
    assert first.points[0].shares.tobytes() == second.points[0].shares.tobytes()
    for x, y in zip(first.points[0].deltas, second.points[0].deltas, strict=True):
        assert x.input == y.input and x.blocks.tobytes() == y.blocks.tobytes()
        assert x.trusted is None
        assert isinstance(y.trusted, bool) == (y.input in tested.bumped), y.input


@pytest.mark.prove
def test_a_judged_contract_has_verdicts(tmp_path):
    file = write_book(tmp_path, ONE, stresses="", more="[tasks]\npaths = 512\nexposure = false\n")
    deltas = points(file, tmp_path / "run")["first"]["base"].deltas
    assert all(isinstance(x.trusted, bool) for x in deltas if x.blocks.any())


def test_a_market_replaces_that_of_its_contracts(tmp_path):
    """Two markets with other curves; a contract that names none of several has a message."""
    rows = [{"name": "a", "market": "low"}, {"name": "b", "market": "high"}]
    file = write_book(tmp_path, rows, stresses="")
    curve = thirty_days()["curve.csv"]
    for name, price in (("low", 1.0), ("high", 2.0)):
        folder = tmp_path / "markets" / name
        folder.mkdir(parents=True)
        lines = curve.splitlines()
        first = next(i for i, line in enumerate(lines) if line[:4].isdigit())
        scaled = [f"{d},{float(p) * price}" for d, p in (x.split(",") for x in lines[first:])]
        (folder / f"{name}.csv").write_text("\n".join([*lines[:first], *scaled]) + "\n")
        (folder / "market.toml").write_text(
            f'[market]\nvaluation_date = 2025-01-01\nforward_curve = "{name}.csv"\n'
            'interest_rate = 0.03\n[model]\nkind = "one-factor"\nmean_reversion = 20.0\n'
            "volatility = 0.9\n"
        )
    markets = "".join(
        f'[markets.{name}]\nfile = "markets/{name}/market.toml"\n' for name in ("low", "high")
    )
    file.write_text(file.read_text() + markets)
    by_case = points(file, tmp_path / "run")
    low, high = (by_case[name]["base"] for name in "ab")
    # Proportional prices with a little cost: about twice the value.
    assert 1.7 < high.value / low.value < 2.3
    (tmp_path / "contracts.csv").write_text("name,market\na,none\n")
    with pytest.raises(CaseError, match="it must be one of low, high"):
        read_book(file)


@pytest.mark.prove
def test_axes_make_a_grid_of_contracts(tmp_path):
    """Two axes of two and three values: six contracts, each with the values as labels."""
    file = write_book(tmp_path, ONE, stresses="")
    axes = (
        '[[axis]]\nkey = "contract.max_injection"\nvalues = [4.0, 6.0]\n'
        '[[axis]]\nkey = "contract.max_inventory"\nvalues = "40:60:3"\n'
    )
    file.write_text(file.read_text().replace('by = ["desk"]', 'by = ["max_inventory"]') + axes)
    contracts = read_book(file).contracts
    assert [x.name for x in contracts][:2] == [
        "first, max_injection 4, max_inventory 40",
        "first, max_injection 4, max_inventory 50",
    ]
    values = {(x.tables["contract"]["max_injection"], x.tables["contract"]["max_inventory"])
              for x in contracts}  # fmt: skip
    assert values == {(i, j) for i in (4, 6) for j in (40, 50, 60)}
    assert contracts[-1].labels["max_inventory"] == "60"
    # A larger store is worth more on the same paths.
    result = run_book(read_book(file), lambda _: None, HERE, out=tmp_path / "run")
    small, middle, large = (rows[0]["value"] for rows in result["by"]["max_inventory"].values())
    assert small < middle < large
    for wrong in ('"5:35"', '"5:35:1"', '"a:b:c"', "[]"):
        file.write_text(file.read_text().rpartition("values")[0] + f"values = {wrong}\n")
        with pytest.raises(CaseError):
            read_book(file)


def test_cases_of_their_own_folders(tmp_path):
    for name in ("one", "two"):
        folder = tmp_path / "contracts" / name
        folder.mkdir(parents=True)
        for file, text in thirty_days().items():
            (folder / file).write_text(text, encoding="utf-8")
    book = tmp_path / "book.toml"
    book.write_text('kind = "book"\n[cases]\nfiles = "contracts/*/case.toml"\n')
    assert [x.name for x in read_book(book).contracts] == ["contracts/one", "contracts/two"]
    outside = 'kind = "book"\n[cases]\ntemplate = "../elsewhere"\n'
    book.write_text(outside)
    with pytest.raises(CaseError, match="in the folder of the book"):
        read_book(book)


def test_a_worker_of_another_processor_refuses(valued):
    """Its bits would be others: the job goes elsewhere."""
    job = BookJob.of(valued.book.contracts[0], valued.book.tasks, 0, fingerprint="elsewhere")
    assert work.compute(job.pack()) == OTHER


def test_a_level_is_the_target_of_all_code(monkeypatch):
    """Where the processor has it; a level that it has not is refused."""
    monkeypatch.setenv(pipeline.PROCESSOR, "")
    actual = pipeline.actual()
    narrow = actual._replace(triple="x86_64-unknown-linux-gnu", register=32)
    monkeypatch.setattr(pipeline, "actual", lambda: narrow)
    pipeline.host.cache_clear()
    try:
        assert not pipeline.use_processor("x86-64-v4") and pipeline.host() == narrow
        assert pipeline.use_processor("x86-64-v2")
        target = pipeline.host()
        assert (target.name, target.features, target.register) == ("x86-64-v2", "", 16)
        assert target.lanes("float64") == 4
    finally:
        monkeypatch.undo()
        pipeline.host.cache_clear()
    assert pipeline.host() == actual


@pytest.mark.prove
@pytest.mark.skipif(platform.machine() != "x86_64", reason="levels are those of x86-64")
def test_a_book_for_a_level_has_its_values(tmp_path):
    """Compiled for the oldest level in two processes: equal bits; but for rounding the values of
    code for this processor."""
    one, two = (
        write_book(tmp_path / name, ONE, stresses="", more=f"{TASKS}[run]\n{run}")
        for name, run in (("level", 'processor = "x86-64-v2"\n'), ("own", ""))
    )
    values = []
    for file, out in ((one, "a"), (one, "b"), (two, "c")):
        where = worker_pools("", 1) if file == one else HERE
        result = run_book(read_book(file), lambda _: None, where, out=tmp_path / out)
        assert result["status"] == "ok", result["failures"]
        values.append(result["sums"][0]["value"])
    assert values[0] == values[1]
    assert values[0] == pytest.approx(values[2], rel=1e-4)  # two steps of training in float32


def test_texts_and_pictures_of_a_report_are_no_part_of_a_job(tmp_path):
    """A job has no files but those with numbers: a logo, which it cannot find, is left out."""
    file = write_book(tmp_path, ONE, stresses="")
    case = tmp_path / "store" / "case.toml"
    (tmp_path / "store" / "logo.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    case.write_text(case.read_text() + '\n[report]\nauthor = "x"\nlogo = "logo.svg"\n')
    (contract,) = read_book(file).contracts
    job = BookJob.of(contract, read_book(file).tasks, 0)
    assert "logo" not in job.case and "logo.svg" not in job.files and "author" not in job.case
