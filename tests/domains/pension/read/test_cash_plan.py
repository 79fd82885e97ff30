"""Payments agreed in money: the steps in which they are paid."""

import datetime

import pytest

from snapo.case.csv import FileReference
from snapo.case.error import CaseError
from snapo.case.table import TableContext
from snapo.domains.pension.read.cash_plan import PlanClock, read_cash_plan
from snapo.domains.pension.read.cells import TimeGrid

START = datetime.date(2024, 12, 31)


def plan(folder, text, step=1 / 12, years=3, arrears=True):
    (folder / "plan.csv").write_text(text)
    section = TableContext(folder / "case.toml", "plan.contribution", [])
    clock = PlanClock(TimeGrid(round(years / step), step, "GBP"), START, arrears)
    return read_cash_plan(FileReference(section, "schedule", "plan.csv"), clock), section.notes


def test_a_date_is_paid_in_its_month(tmp_path):
    text = "date,amount\n2025-03-31,5000000\n2026-04-01,4e6\n2027-12-20,1\n"
    found, notes = plan(tmp_path, text)
    # At the end of the third month, of the fifteenth and of the thirty-sixth.
    assert found.step.tolist() == [2, 14, 35]
    assert found.amount.values.tolist() == [5e6, 4e6, 1.0]
    assert found.amount.labels == ("2025-03-31", "2026-04-01", "2027-12-20")
    assert found.amount.unit == "GBP"
    assert not notes
    assert plan(tmp_path, text.split("2027")[0], arrears=False)[0].step.tolist() == [3, 15]


def test_years_from_now_and_yearly_steps(tmp_path):
    text = "year,amount\n0.5,1\n1,2\n1.25,3\n"
    assert plan(tmp_path, text, step=1.0)[0].step.tolist() == [0, 0, 1]
    assert plan(tmp_path, text, step=1.0, arrears=False)[0].step.tolist() == [0, 1, 1]


def test_payments_after_the_horizon_are_left_out_with_a_note(tmp_path):
    found, notes = plan(tmp_path, "year,amount\n1,2\n4,3\n")
    assert found.step.tolist() == [11]
    assert notes == ["plan.csv: 1 of 2 payments fall after the horizon and are left out."]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("date,amount\n2024-12-31,1\n", "after the valuation date, 2024-12-31"),
        ("date,amount\n2026-01-01,1\n2025-01-01,1\n", "times must increase"),
        ("date,amount\n2026-01-01,-1\n", "at least 0"),
        ("date,year,amount\n2026-01-01,1,1\n", "exactly one of the columns date and year"),
        ("date,amuont\n2026-01-01,1\n", "amount is missing"),
        ("year,amount\n9,1\n", "no payment falls within the horizon"),
    ],
)
def test_a_mistake_is_named(tmp_path, text, named):
    with pytest.raises(CaseError, match=named):
        plan(tmp_path, text)
