"""One convention of compounding for all rates of a case, against sums of annual discounting."""

import datetime

import numpy as np
import pytest
from tests.domains.pension.every_key import MARKET, written

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters.stress import zero_rates
from snapo.domains.pension.read.case import resolve
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.problem.inputs import plain

FLOWS = {1: 100.0, 5: 200.0, 10: 900.0, 20: 400.0}
FUND = {"years": 2, "step": "year", "assets": 1000.0, "valuation_date": datetime.date(2024, 12, 31)}


def case_of(folder, compounding="annual", **changes):
    """Payments at the end of years on a curve of 2.0 to 2.5 %."""
    file = written(folder)
    rows = "".join(f"{year},{amount}\n" for year, amount in FLOWS.items())
    (folder / "flows.csv").write_text("year,amount\n" + rows)
    data = MARKET | {"members": {"cash_flows": "flows.csv"}, "fund": FUND}
    del data["mortality"]
    data["curve"] = {"file": "zero.csv", "compounding": compounding}
    return resolve(file, data | changes)


def value(case):
    return figures(case, plain(pension_inputs(case))).liability


def zero(year):
    return np.interp(year, [1, 10, 30], [0.02, 0.024, 0.025])


def test_a_fixed_annual_rate_discounts_by_whole_years(tmp_path):
    found = value(case_of(tmp_path, liability={"basis": "fixed", "rate": 0.07}))
    assert found == pytest.approx(sum(x * 1.07**-t for t, x in FLOWS.items()), rel=1e-12)


def test_an_annual_spread_is_added_to_annual_rates_of_the_curve(tmp_path):
    case = case_of(tmp_path, liability={"basis": "spread", "rate": 0.01})

    def rate(t):
        """Annual: continuous zero rates are linear between the nodes."""
        ends = np.log1p([0.02, 0.024, 0.025])
        return np.expm1(np.interp(t, [1, 10, 30], ends)) + 0.01

    expected = sum(x * (1 + rate(t)) ** -t for t, x in FLOWS.items())
    assert value(case) == pytest.approx(expected, rel=1e-12)
    # Its continuous form is held while the curve moves, so that rates move the liability alike.
    found = figures(case, plain(pension_inputs(case)))
    assert found.key_rate.sum() == pytest.approx(-1e-4 * found.duration * found.liability, rel=1e-9)
    inputs = plain(pension_inputs(case))
    up, down = (
        figures(case, inputs | {"liability_rate": inputs["liability_rate"] + h}).liability
        for h in (1e-6, -1e-6)
    )
    slope = sum(-t * x * (1 + rate(t)) ** (-t - 1) for t, x in FLOWS.items())
    assert (up - down) / 2e-6 == pytest.approx(slope, rel=1e-6)


def test_continuous_rates_stay_as_they_are(tmp_path):
    case = case_of(tmp_path, "continuous", liability={"basis": "spread", "rate": 0.01})
    expected = sum(x * np.exp(-t * (zero(t) + 0.01)) for t, x in FLOWS.items())
    assert value(case) == pytest.approx(expected, rel=1e-12)


def test_zero_rates_of_ready_made_scenarios_follow_the_curve(tmp_path):
    """A curve that stays where it is, in the same convention: nothing drifts."""
    case = case_of(tmp_path, scenarios={"training": "training.csv", "evaluation": "evaluation.csv"})
    given = case_of(
        tmp_path,
        "continuous",
        scenarios={"training": "training.csv", "evaluation": "evaluation.csv"},
    )
    for kind in ("training", "evaluation"):
        annual, plain_ones = (getattr(each.scenarios, kind) for each in (case, given))
        np.testing.assert_allclose(annual[..., -2:], np.log1p(plain_ones[..., -2:]), rtol=1e-14)
        np.testing.assert_array_equal(annual[..., :-2], plain_ones[..., :-2])


def test_break_evens_and_wages_follow_it_unless_they_say_otherwise(tmp_path):
    table = {"break_evens": "break_evens.csv", "real_wage_growth": 0.01}
    for own, expected in (({}, np.log1p), ({"compounding": "continuous"}, np.asarray)):
        case = case_of(tmp_path, inflation=table | own)
        assert zero_rates(case.inflation.break_even) == pytest.approx(expected([0.018, 0.02]))
        assert case.inflation.real_wage_growth.used() == pytest.approx(expected(0.01))


@pytest.mark.prove
def test_check_names_both_conventions(tmp_path):
    lines = DOMAIN.check(case_of(tmp_path, liability={"basis": "fixed", "rate": 0.07}))
    assert any(line.startswith("rates, annual: 1y 2.00%, 10y 2.40%") for line in lines)
    assert any(line.startswith("rates, continuous: 1y 1.98%, 10y 2.37%") for line in lines)
    assert "valuation: at 7.00% annual, 6.77% continuous" in lines
