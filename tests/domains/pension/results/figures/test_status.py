"""Members by status and payments of today, by hand and by a sum over people from the files."""

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, written
from tests.domains.pension.miniature import TEMPLATES, short_case
from tests.domains.pension.test_template_liability import MONTHS, rows, survival

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.read.case import read_case, resolve
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.results.figures.reconcile import figures
from snapo.domains.pension.results.figures.status import groups, pace
from snapo.problem.inputs import plain

LIABILITY = 318916480.0  # of the small example; see `test_template_liability`


def status_and_pace(case):
    inputs = plain(pension_inputs(case))
    return groups(case, inputs), pace(case, inputs, figures(case, inputs).liability)


@pytest.fixture(scope="module")
def small():
    return status_and_pace(read_case(TEMPLATES / "small"))


def discount():
    """Of payments at the end of each month: the curve and 0.2 %."""
    nodes = rows("curve.csv")
    tenor, zero = (np.array([float(r[key]) for r in nodes]) for key in ("tenor", "zero"))
    time = np.arange(1, MONTHS + 1) / 12
    last = (zero[-1] * tenor[-1] - zero[-2] * tenor[-2]) / (tenor[-1] - tenor[-2])
    grown = np.interp(time, tenor, zero) * np.minimum(time, tenor[-1])
    grown += last * np.maximum(time - tenor[-1], 0.0)
    return np.exp(-grown - 0.002 * time)


def flow(row):
    """Payments by month to one member, and to the spouse, for a pension of 12 a year."""
    sex, age = row["sex"], int(row["age"])
    alive = survival(sex, age)
    waits = row["status"] in ("active", "deferred")
    paid = alive * ((age + np.arange(MONTHS) / 12 >= 67 - 1e-9) | (not waits))
    if row["status"] != "spouse":
        other, gap = ("female", -3) if sex == "male" else ("male", 3)
        paid = paid + 0.7 * 0.65 * (1 - alive) * survival(other, age + gap)
    return paid


@pytest.mark.prove
def test_members_pensions_and_payroll_are_those_of_the_file(small):
    """420 + 380 + 510 + 430 actives, and so on: sums over the rows of cohorts.csv."""
    assert [item[:4] for item in small[0]] == [
        ("active", 1740.0, 11_365_000.0, 77_530_000.0),
        ("deferred", 680.0, 2_454_000.0, 0.0),
        ("pensioners", 1090.0, 11_326_000.0, 0.0),
        ("spouses", 190.0, 1_159_000.0, 0.0),
    ]


def test_the_liability_by_status_is_a_sum_over_people(small):
    now, total = discount(), dict.fromkeys(("active", "deferred", "pensioner", "spouse"), 0.0)
    for row in rows("cohorts.csv"):
        pension = float(row["number"]) * float(row["pension"]) / 12
        total[row["status"]] += pension * flow(row) @ now
    assert [item.liability for item in small[0]] == pytest.approx(list(total.values()), rel=1e-9)
    assert sum(item.liability for item in small[0]) == pytest.approx(LIABILITY, rel=1e-8)


def test_the_cost_of_accrual_is_a_sum_over_actives(small):
    """A month earns 1.75 % of salary less 15,000, by twelve, paid from the next month on."""
    now, cost = discount(), 0.0
    for row in rows("cohorts.csv"):
        if row["status"] == "active":
            earned = float(row["number"]) * 0.0175 * (float(row["salary"]) - 15000) / 12
            # A spouse's pension comes with the right, which whoever died before has not earned.
            cost += earned * (flow(row)[1:] @ now[1:])
    assert small[1].accrual == pytest.approx(cost, rel=1e-9)
    assert small[1].payroll == pytest.approx(77_530_000.0)


def test_today_s_contribution_spreads_the_surplus(small):
    """The accrual and 6 % a year of what is missing: 325 million are there."""
    due = small[1].accrual + 0.06 * (LIABILITY - 325e6)
    assert 0.05 < due / 77.53e6 < 0.35  # within its limits
    assert small[1].contribution == pytest.approx(due, rel=1e-6)


def test_payments_of_today_and_the_increase(small):
    """The first month times twelve; prices grow by 1.895 % (continuous), and the ramp from 1 to 1.2
    grants (325 / 318.9 - 1) / 0.2 of it."""
    paid = sum(
        float(row["number"]) * float(row["pension"]) * flow(row)[0] for row in rows("cohorts.csv")
    )
    granted = np.expm1(0.01895) * (325e6 / LIABILITY - 1) / 0.2
    now = small[1]
    assert now.benefits == pytest.approx(paid, rel=1e-9)
    assert now.expenses == pytest.approx(900_000.0)
    assert now.increase == pytest.approx(granted, rel=1e-6)
    assert now.raised == pytest.approx(granted * paid, rel=1e-6)
    assert now.liability_raised == pytest.approx(granted * LIABILITY, rel=1e-6)


def test_check_prints_three_lines():
    text = DOMAIN.check(read_case(TEMPLATES / "small"))
    first = [item.partition(":")[0] for item in text].index("members")
    members, cost, paid = text[first : first + 3]
    assert members == (
        "members: 1,740 active with pensions of EUR 11.4 million, payroll EUR 77.5 million, "
        "liability EUR 118.6 million; 680 deferred with pensions of EUR 2.5 million, liability EUR "
        "24.9 million; 1,090 pensioners with pensions of EUR 11.3 million, liability EUR 163.6 "
        "million; 190 spouses with pensions of EUR 1.2 million, liability EUR 11.8 million"
    )
    assert cost == (
        "a year's accrual costs EUR 8.9 million, 11.5% of payroll; today's contribution is EUR 8.6 "
        "million, 11.1% of payroll"
    )
    assert paid == (
        "payments today, per year: benefits EUR 12.5 million, expenses EUR 900.0 thousand, "
        "increase 0.18%: EUR 22.8 thousand of benefits and EUR 581.9 thousand of liability"
    )


@pytest.mark.prove
def test_limits_agreed_payments_and_cuts_count(tmp_path):
    """A floor of 20 % of payroll; 1.2 million agreed in the first month; 90 % funded and cut by
    (1 - 0.9) / 5."""
    (folder := short_case(tmp_path / "case", [
        ("case.toml", "floor = 0.05 ", "floor = 0.2 "),
        ("case.toml", "# schedule = ", "schedule = "),
        ("case.toml", "assets = 325000000.0", f"assets = {0.9 * LIABILITY}"),
        ("case.toml", "# required_ratio = 1.0", "required_ratio = 1.0"),
        ("case.toml", "# cut_years = 0 ", "cut_years = 5 "),
    ]) / "recovery.csv").write_text("date,amount\n2025-01-31,100000\n")  # fmt: skip
    _, now = status_and_pace(read_case(folder.parent))
    assert now.contribution == pytest.approx(0.2 * 77_530_000.0 + 12 * 100_000, rel=1e-9)
    assert now.increase == pytest.approx(-0.1 / 5, rel=1e-6)
    assert now.liability_raised == pytest.approx(-0.02 * LIABILITY, rel=1e-6)


@pytest.mark.prove
@pytest.mark.parametrize("name", list(CASES))
def test_every_kind_of_case_has_its_lines(name, tmp_path):
    """By status they add up to the liability; fixed increases are in it already."""
    path = written(tmp_path)
    data = CASES[name] | {"reconcile": None}
    case = resolve(path, {key: item for key, item in data.items() if item is not None})
    inputs = plain(pension_inputs(case))
    liability = figures(case, inputs).liability
    members, now = status_and_pace(case)
    if case.members is None:
        assert not members
        assert now.accrual == pytest.approx(5.0)  # the normal cost of the case
    else:
        assert sum(item.liability for item in members) == pytest.approx(liability, rel=1e-9)
    if case.plan.indexation.kind == "fixed":
        assert now.increase in (0.03, 0.025)
        assert now.liability_raised == 0
    lines = "\n".join(DOMAIN.check(case))
    assert "today's contribution is GBP" in lines
    assert ("as earned" in lines) == (case.pots is not None)
