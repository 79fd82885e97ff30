"""A pension run from its file to its folder: the files, and the identities of their figures."""

import csv
import json
import math

import numpy as np
import pytest
from tests.domains.pension.miniature import short_case, solved

from snapo.case.error import CaseError
from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters import stress
from snapo.domains.pension.people.longer_life import year_of_life
from snapo.domains.pension.read.case import read_case
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.people import FEMALE, MALE
from snapo.domains.pension.results import balance
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain
from snapo.study.carry_out import write_report

pytestmark = pytest.mark.study  # two minutes and more of compiling

KEYS = {
    "kind": str,
    "value": float,
    "standard_error": float,
    "smooth_value": float,
    "smoothing_gap": float,
    "policy_gradient_norm": float,
    "references": dict,
    "seconds": dict,
    "engine": str,
    "paths": dict,
    "seed": int,
    "status": str,
    "run": str,
}
SEXES = {"male": MALE, "female": FEMALE}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The small example with a short horizon and little training."""
    return short_case(tmp_path_factory.mktemp("fund") / "case")


@pytest.fixture(scope="module")
def case(folder):
    return read_case(folder)


@pytest.fixture(scope="module")
def done(folder):
    """The run's result and its folder."""
    return solved(folder), folder / "run"


@pytest.fixture(scope="module")
def details(done):
    """The tables of all parts."""
    found = json.loads((done[1] / "run.json").read_text())["about"]
    for file in (done[1] / "parts").glob("*.json"):
        found |= json.loads(file.read_text())
    return found


def test_the_result_is_complete_and_written(done):
    result, out = done
    assert {key: type(result[key]) for key in KEYS} == KEYS
    assert result["status"] == "trained"
    assert math.isfinite(result["value"])
    tuned, held = ("constant_mix", "glide_path", "liability_driven"), "present_mix"
    assert set(result["references"]) == {*tuned, held, f"{held}_yearly"}
    written = json.loads((out / "result.json").read_text())
    assert written["value"] == result["value"]
    for name in (
        "history.csv",
        "profile.csv",
        "policy.npz",
        "report.html",
        "case/case.toml",
        "parts/today.json",
    ):
        assert (out / name).is_file()


def test_every_input_has_its_sensitivity(done, case):
    with (done[1] / "sensitivities.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 32
    assert all(math.isfinite(float(row["value"])) for row in rows)


def test_a_parallel_shift_is_the_sum_of_its_key_rates(details):
    rows = details["sensitivities"]["rows"]
    for family in details["sensitivities"]["families"]:
        total = math.fsum(r["effect"] for r in rows if r["input"] == family["input"])
        assert family["effect"] == pytest.approx(total, rel=1e-9, abs=1e-14)
    ladder = details["ladder"]["liability"]
    duration = details["reconciliation"]["duration"]
    assert -1e4 * sum(ladder) / details["liability"] == pytest.approx(duration, rel=1e-6)


def test_what_moves_the_ratio_adds_up_to_its_change(details):
    found = details["attribution"]
    total = math.fsum(row["mean"] for row in found["rows"])
    assert total == pytest.approx(found["change"]["mean"], abs=1e-12)
    assert found["start"] == pytest.approx(details["funding"], rel=1e-12)
    for row in found["rows"]:
        assert row["assets"] + row["liability"] == pytest.approx(row["mean"], abs=1e-14)


def test_a_year_of_life_is_the_sum_over_multipliers(case, details):
    (combined,) = details["sensitivities"]["combined"]
    given = plain(pension_inputs(case))
    scale = {name: year_of_life(case, given, sex) - 1 for name, sex in SEXES.items()}
    rows = [r for r in details["sensitivities"]["rows"] if r["input"] == "mortality_multiplier"]
    # Rows are per 1 % of themselves.
    want = math.fsum(100 * r["effect"] * scale[r["label"].split()[0]] for r in rows)
    assert combined["effect"] == pytest.approx(want, rel=1e-9)
    assert combined["effect"] < 0  # longer lives cost money
    assert combined["standard_error"] > 0


def test_the_frontier_has_its_points_with_errors(details):
    found = details["frontier"]
    assert [each["share"] for each in found["points"]] == [0, 1]
    for each in (*found["points"], found["learned"]):
        assert each["contributions_error"] > 0
        assert each["cvar"] <= 0 < each["cvar_error"]
    assert any(each["efficient"] for each in found["points"])
    learned = details["policies"][0]
    assert found["learned"]["contributions"] == pytest.approx(learned["pv_contribution"])


def test_the_curve_is_refitted_by_bonds_bought_at_the_horizon(details):
    tests = details["market_consistency"]
    names = [each["name"] for each in tests if each["name"].startswith("Fit of")]
    terms = "1 year", "10 years", "30 years"
    assert names == [f"Fit of the curve: bond of {u} bought after 2 years" for u in terms]
    durations = details["reconciliation"]["key_rate_durations"]["years"]
    assert math.fsum(durations) == pytest.approx(details["reconciliation"]["duration"], rel=1e-9)


def test_limits_are_told_by_month(details):
    assert set(details["limits"]) == {"weights", "collateral"}
    for each in details["limits"].values():
        assert len(each["share"]) == 24
        assert max(each["share"]) <= each["ever"] <= 1
    assert details["limits"]["weights"]["ever"] == 0


def test_checks_hold(details):
    assert all(row["ok"] for row in details["market_consistency"])
    assert all(row["passed"] is not False for row in details["certificate"]["bump_check"])
    assert all(
        row["passed"] for row in details["certificate"]["feasibility"] if row["limit"] == "weights"
    )


def test_the_learned_policy_stands_first_and_leads_itself_by_nothing(details):
    first = details["policies"][0]
    assert first["key"] == "learned"
    assert first["lead"] == first["difference"] == 0
    assert all(math.isfinite(each["lead_error"]) for each in details["policies"][1:])


def test_trades_lead_from_today_s_weights_to_weights_within_bounds(details):
    rows = details["trades"]["classes"]
    assert sum(row["now"] for row in rows) == pytest.approx(1)
    assert sum(row["target"] for row in rows) == pytest.approx(1)
    assert sum(row["trade"] for row in rows) == pytest.approx(0, abs=1e-3)
    assert all(row["low"] - 1e-6 <= row["target"] <= row["high"] + 1e-6 for row in rows)


def test_distributions_start_at_today_s_funding_ratio(details):
    fan = details["by_year"]["funding"]
    assert fan["p01"][0] == pytest.approx(details["funding"], rel=1e-6)
    assert fan["p01"][2] < fan["p50"][2] < fan["p99"][2]
    assert len(details["by_year"]["contribution"]["mean"]) == 2


def test_the_report_can_be_written_again(done):
    before = (done[1] / "report.html").read_bytes()
    write_report(DOMAIN, done[1])
    assert (done[1] / "report.html").read_bytes() == before
    assert b'class="missing"' not in before


# The balance sheet.


def test_a_small_shock_agrees_with_the_key_rates(case):
    """Full revaluation of one basis point against the ladder, to the convexity of both."""
    inputs = plain(pension_inputs(case))
    found = figures(case, inputs)
    notional = np.array([4e7, 2e7])
    ladder = balance.ladder(case, inputs, found, notional)
    curve = case.curve.rate.values + 1e-4
    shock = stress.Stressed("1 bp", {"zero_rate": curve}, np.ones(len(case.assets.classes)))
    after = stress.stressed(case, inputs, shock, notional)
    amount = float(case.assets.amount.used())
    moved = float(np.sum(ladder.assets + ladder.swaps))
    assert after.assets - amount == pytest.approx(moved, rel=2e-3)
    assert after.liability - found.liability == pytest.approx(ladder.liability.sum(), rel=5e-3)


def test_prices_fall_by_what_the_shock_says(case):
    price = np.array([1, 1, 1, 1, 0.7, 1.0])
    shock = stress.Stressed("equity", {}, price)
    after = stress.stressed(case, plain(pension_inputs(case)), shock, np.zeros(2))
    amount = float(case.assets.amount.used())
    assert after.assets == pytest.approx(amount * (1 - 0.3 * 0.35))


def test_a_figure_within_its_tolerance_is_accepted(tmp_path, case):
    own = figures(case, plain(pension_inputs(case))).liability
    figure = ("case.toml", "liability = 318916480.0", f"liability = {own * 1.0004}")
    copy = short_case(tmp_path / "near", [figure])
    assert any("given" in line for line in DOMAIN.check(read_case(copy)))
    tight = ("case.toml", "tolerance = 0.001", "tolerance = 0.0001")
    copy = short_case(tmp_path / "far", [figure, tight])
    with pytest.raises(CaseError, match=r"the tolerance is 0\.0001"):
        DOMAIN.check(read_case(copy))


def test_a_run_with_appraised_property_is_trained_and_told(tmp_path):
    """Training is in 32 bits, all the rest in 64: the positions of classes serve both."""
    folder = short_case(tmp_path / "case")
    lines = (folder / "assets.csv").read_text().splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("name"))
    for i, line in enumerate(lines[head:], head):
        lines[i] = line + (",smoothing" if i == head else ",0.4" * line.startswith("Property"))
        lines[i] += "," * (i > head and not line.startswith("Property"))
    (folder / "assets.csv").write_text("\n".join(lines) + "\n")
    result = solved(folder)
    assert result["status"] == "trained", result["failures"]
    assert result["failures"] == {}


def test_a_resumed_run_has_the_same_bits(folder, done):
    """A part that was lost is worked out again from the others' files."""
    part = done[1] / "parts" / "today.json"
    before = part.read_bytes()
    part.unlink()
    result = solved(folder, resume=True)
    assert result["value"] == done[0]["value"]
    assert part.read_bytes() == before
