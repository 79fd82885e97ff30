"""What a pension case says, from its files to the records."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pension.miniature import TEMPLATES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters import stress
from snapo.domains.pension.chapters.stress import zero_rates
from snapo.domains.pension.fund.observation import FEATURES
from snapo.domains.pension.market.registry import MODELS
from snapo.domains.pension.read.case import read_case, resolve
from snapo.domains.pension.read.stress import read_shocks
from snapo.domains.pension.records.inputs import every_given, pension_inputs
from snapo.domains.pension.records.people import ACTIVE, FEMALE, MALE, SPOUSE
from snapo.domains.pension.results.figures.reconcile import check, figures
from snapo.problem.inputs import plain

GROUPS = {
    "curve",
    "volatility",
    "premium",
    "model",
    "credit",
    "assets",
    "overlay",
    "people",
    "plan",
}
COUNTS = {"small": 32, "medium": 290, "large": 1900, "wtp": 47}
STEPS = {"small": 120, "medium": 240, "large": 360, "wtp": 180}


@pytest.fixture(scope="module", params=COUNTS)
def sized(request):
    """Each example with its size."""
    return request.param, read_case(TEMPLATES / request.param)


@pytest.fixture(scope="module")
def small():
    return read_case(TEMPLATES / "small")


@pytest.fixture
def folder(tmp_path):
    """A copy of the small example that a test may change."""
    return Path(shutil.copytree(TEMPLATES / "small", tmp_path / "case"))


def changed(folder: Path, *pairs: tuple[str, str], file: str = "case.toml"):
    """The case after the replacements in one of its files."""
    text = (folder / file).read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / file).write_text(text)
    return read_case(folder)


def test_the_examples_have_exactly_so_many_inputs(sized):
    size, case = sized
    inputs = pension_inputs(case)
    assert sum(entry.value.size for entry in inputs.values()) == COUNTS[size]
    for name, entry in inputs.items():
        assert len(set(entry.names())) == entry.value.size, f"{name}: a label stands there twice"


def test_every_number_that_is_no_input_was_held_by_name(sized):
    _, case = sized
    names = [given.name for given in every_given(case)]
    assert len(names) == len(set(names))
    assert set(names) == set(pension_inputs(case)) | set(case.held)


def test_every_number_says_what_is_moved(sized):
    _, case = sized
    for given in every_given(case):
        assert given.meaning, given.name
        assert given.group in GROUPS, given.name


def test_the_examples_are_funds_that_could_be(sized):
    _, case = sized
    assets = case.assets
    weights = assets.weight.used()
    assert weights.sum() == pytest.approx(1)
    assert np.all((assets.low <= weights) & (weights <= assets.high))
    for group in assets.groups:
        assert group.low <= weights[list(group.members)].sum() <= group.high
    lower = np.zeros((len(case.correlation.names),) * 2)
    lower[np.tril_indices(len(lower), -1)] = case.correlation.lower.used()
    assert np.linalg.eigvalsh(lower + lower.T + np.eye(len(lower)))[0] > 0.02
    assert case.start_month == 1  # 31 December is the eve of January


@pytest.mark.parametrize("size", COUNTS)
def test_each_size_has_its_horizon(size):
    assert read_case(TEMPLATES / size).steps == STEPS[size]
    assert next(iter(DOMAIN.templates)) == "small"


def test_numbers_stand_where_the_files_have_them(small):
    assert small.curve.rate.labels[-1] == "50y"
    assert small.rates.volatility.index.shape == (120, 1)
    assert [each.kind for each in small.assets.classes].count("bond") == 2
    assert small.assets.classes[1].maturity == 120  # months
    assert small.assets.mean.labels == ("Equity", "Property")
    assert small.assets.groups[0].low == 0.2
    assert small.overlay is not None
    assert small.overlay.maturity.tolist() == [120, 360]
    members, mortality = small.members, small.mortality
    assert members is not None
    assert mortality is not None
    assert members.status[0] == ACTIVE
    assert members.status[-1] == SPOUSE
    assert mortality.first_age == 20
    # The public life table at 65, and the multipliers by sex.
    assert mortality.table.used()[MALE, 45] == 0.016013
    assert mortality.multiplier.used()[FEMALE, 10] == 0.95
    assert members.salary.index.shape == (9,)
    assert members.salary.labels == members.names[:4]


def test_the_page_names_every_model_and_every_part_of_the_observation():
    text = (Path(__file__).parents[4] / "docs" / "pension_case.md").read_text()
    for name in MODELS:
        assert f'"{name}"' in text, name
    for name in FEATURES:
        assert name in text, name


def test_annual_rates_are_made_continuous(folder):
    case = changed(folder, ('measure = "P" ', 'measure = "P"\ncompounding = "annual" '))
    plain = read_case(TEMPLATES / "small")
    assert np.allclose(case.curve.rate.values, np.log1p(plain.curve.rate.values), rtol=1e-15)
    assert "continuous" in case.notes[0]


def test_volatilities_may_change_in_time(folder):
    (folder / "steps.csv").write_text("from_year,value\n0,0.01\n2.5,0.008\n40,0.005\n")
    case = changed(folder, ("volatility = 0.008  ", 'volatility = "steps.csv"  '))
    used = case.rates.volatility.used()[:, 0]
    assert np.all(used[:30] == 0.01)
    assert np.all(used[30:] == 0.008)
    # What begins after the horizon moves nothing, and is no input.
    assert case.rates.volatility.labels == ("from 0y", "from 30m")


def test_what_was_left_at_its_default_is_held(folder):
    case = changed(folder, ("index_volatility = 0.01", "# "), ('"index_volatility",', ""))
    assert "index_volatility" in case.held
    assert "index_price_of_risk" in case.held


def test_under_q_what_counts_in_the_real_world_only_is_held(folder):
    case = changed(folder, ('measure = "P"', 'measure = "Q"'))
    assert {"asset_mean", "credit_default_loss"} <= set(case.held)
    assert case.risk_neutral


def test_a_matrix_is_repaired_only_when_asked(folder):
    text = (folder / "correlations.csv").read_text()
    text = text.replace("Property,-0.5,0,0.5", "Property,-0.95,0.95,0.95")
    (folder / "correlations.csv").write_text(text)
    case = changed(folder, ("# repair = false", "repair = true"))
    assert case.correlation.repaired > 0.1
    assert "nearest" in case.notes[0]


def without_cohorts(data):
    """Leaves out the keys of the plan that a case of cash flows has no use for."""
    about = ("timing", "expenses", "indexation", "contribution")
    data["plan"] = {key: data["plan"][key] for key in about}


def test_an_actuary_s_cash_flows_in_place_of_members(folder):
    rows = "".join(f"{year},{100 * year}\n" for year in range(1, 41))
    (folder / "flows.csv").write_text("year,amount\n" + rows)
    data = load(folder)[1]
    for key in ("mortality", "sensitivity", "stress"):
        del data[key]
    data["members"] = {"cash_flows": "flows.csv", "normal_cost": 1200.0, "salary": 9000.0}
    without_cohorts(data)
    case = resolve(folder / "case.toml", data)
    assert case.members is None
    assert case.cash_flows is not None
    # Paid in arrears: what is due after a year belongs to the twelfth step.
    assert case.cash_flows.step[:2].tolist() == [11, 23]
    assert case.cash_flows.normal_cost.used() == pytest.approx(100.0)


def test_a_frontier_needs_contributions_that_depend_on_decisions(folder):
    data = load(folder)[1]
    asked = resolve(folder / "case.toml", data).frontier
    assert asked is not None
    assert (asked.points, asked.steps, asked.level) == (5, 40, 0.95)
    data["plan"]["contribution"] = {"kind": "normal-cost"}
    del data["sensitivity"]
    with pytest.raises(CaseError, match=r'frontier.points.*"normal-cost" do not depend'):
        resolve(folder / "case.toml", data)


@pytest.mark.prove
@pytest.mark.parametrize("timing", ["arrears", "advance"])
def test_the_last_payment_may_be_due_after_exactly_100_years(timing, folder):
    """At the end of the last step; a payment in advance would begin one more step."""
    (folder / "flows.csv").write_text("year,amount\n1,5\n100,7\n")
    data = load(folder)[1]
    for key in ("mortality", "sensitivity", "stress", "reconcile"):
        del data[key]
    data["members"] = {"cash_flows": "flows.csv"}
    without_cohorts(data)
    data["plan"]["timing"] = timing
    if timing == "advance":
        with pytest.raises(CaseError, match=r"flows.csv, line 3.*'100'.*must be before year 100"):
            resolve(folder / "case.toml", data)
        return
    case = resolve(folder / "case.toml", data)
    found = figures(case, plain(pension_inputs(case)))
    # Beyond the last node the last forward rate goes on; the basis adds a spread.
    tenor, quotes, rate = case.curve.tenor, case.curve.rate.values, 0.002
    forward = (quotes[-1] * tenor[-1] - quotes[-2] * tenor[-2]) / (tenor[-1] - tenor[-2])
    far = quotes[-1] * tenor[-1] + forward * (100 - tenor[-1])
    want = 5 * np.exp(-quotes[tenor == 1][0] - rate) + 7 * np.exp(-far - 100 * rate)
    assert found.liability == pytest.approx(want, rel=1e-12)
    lines = {line.name: line for line in check(case, plain(pension_inputs(case)))}
    assert lines["liability on payment nodes"].ok


def test_supplied_scenarios_stand_in_the_order_of_the_records(folder):
    names = [f"return {each.name}" for each in read_case(folder).assets.classes]
    columns = ["wage", "inflation", "zero 10", "zero 2", *reversed(names)]
    lines = [",".join(["path", "date", *columns])]
    for path in ("a", "b", "c"):
        for month in range(120):
            day = f"{2025 + month // 12}-{month % 12 + 1:02d}-28"
            cells = [0.002, 0.001, 0.03, 0.02] + [0.01 * i for i in range(6)]
            cells[0] += 1e-6 * month
            lines.append(",".join([path, day, *map(str, cells)]))
    for name in ("one.csv", "two.csv"):
        (folder / name).write_text("\n".join(lines) + "\n")
    data = load(folder)[1]
    data["scenarios"] = {"training": "one.csv", "evaluation": "two.csv"}
    case = resolve(folder / "case.toml", data)
    supplied = case.scenarios
    assert supplied is not None
    assert supplied.training.shape == (3, 120, 10)
    assert supplied.columns[6:] == ("inflation", "wage", "zero 2", "zero 10")
    assert supplied.training[1, 7].tolist() == pytest.approx(
        [0.05, 0.04, 0.03, 0.02, 0.01, 0.0, 0.001, 0.002 + 7e-6, 0.02, 0.03]
    )
    assert {"break_even", "correlation", "asset_mean"} <= set(case.held)
    assert "rates" not in case.observation


def test_an_objective_may_have_several_terms(folder):
    data = load(folder)[1]
    data["objective"] = [
        {"kind": "cvar", "level": 0.95},
        {"kind": "mean", "output": "pv_contribution", "weight": -1e-9},
    ]
    terms = resolve(folder / "case.toml", data).objective
    assert [term.output for term in terms] == ["surplus_ratio", "pv_contribution"]
    assert [term.weight for term in terms] == [1.0, -1e-9]


# Shocks.


def test_a_parallel_shock_moves_every_zero_rate(sized):
    """Also where the case quotes forward rates."""
    _, case = sized
    moved = {each.scenario: each for each in stress.scenarios(case, read_shocks(case))}
    values = moved["Rates +100 bp"].values[case.curve.rate.name]
    shifted = replace(case.curve, rate=replace(case.curve.rate, values=values))
    change = zero_rates(shifted) - zero_rates(case.curve)
    assert np.allclose(change, 0.01, atol=1e-12)


def test_a_regulator_s_factors_are_of_annual_rates_and_linear_between_tenors(small):
    moved = {each.scenario: each for each in stress.scenarios(small, read_shocks(small))}
    after = np.expm1(moved["Dutch FTK rates down"].values["zero_rate"])
    factor = after / np.expm1(small.curve.rate.values)
    # Published at 1, 5, 10 and from 16 years: .49, .67, .75, .76.
    at = dict(zip(small.curve.tenor, factor))
    known = [at[year] for year in (1, 5, 10, 20, 50)]
    assert known == pytest.approx([0.49, 0.67, 0.75, 0.76, 0.76], abs=1e-12)
    assert at[3] == pytest.approx(0.58, abs=1e-12)


def test_a_fall_in_equity_reaches_its_classes_alone(small):
    moved = {each.scenario: each for each in stress.scenarios(small, read_shocks(small))}
    price = moved["Equity -40 %"].price
    assert price.tolist() == pytest.approx([1, 1, 1, 1, 0.6, 1])
