"""Technical provisions, low dependency and buy-out of a scheme, by hand."""

import datetime
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.domains.pension.market_cases import (
    CASH,
    assets,
    case,
    cash_flows,
    curve,
    given,
    inflation,
    plan,
)

from snapo.case.error import CaseError
from snapo.domains.pension.read.cells import TableReader
from snapo.domains.pension.read.tables import FundingTable
from snapo.domains.pension.records.plan import Liability
from snapo.domains.pension.regulation.bases import (
    Due,
    bases,
    discounted,
    read_funding,
    side_by_side,
)

DAY = datetime.date(2024, 12, 31)


def scheme(day=DAY, amount=80.0, **keys):
    """Payments of 50 after 10 and after 20 years, gilts at 4 % a year, assets of `amount`."""
    place = TableReader(Path("case.toml"), "funding", [], set())
    usual = {"rules": "uk", "technical_provisions": 0.01, "buy_out": -0.002}
    held = replace(assets(1, [CASH], weight=[1.0]), amount=given("assets", amount))
    one = case(1, step=1.0, held_assets=held)
    return replace(one, funding=read_funding(place, FundingTable(**usual | keys), day))


def due():
    years = np.arange(31.0)
    flow = np.zeros(31)
    flow[[10, 20]] = 50.0
    return Due(flow, 1.04**-years, years)


def test_every_basis_has_its_own_rate():
    """v = 1 / 1.05, 1 / 1.045 and 1 / 1.038: liability, surplus, ratio and duration by hand."""
    found = side_by_side(scheme(), due())
    assert [each.name for each in found.bases] == [
        "Technical provisions", "Low dependency", "Buy-out",
    ]  # fmt: skip
    for each, rate in zip(found.bases, (0.05, 0.045, 0.038)):
        early, late = 50 * (1 + rate) ** -10, 50 * (1 + rate) ** -20
        assert each.liability == pytest.approx(early + late, rel=1e-14)
        assert each.surplus == pytest.approx(80 - early - late, rel=1e-13)
        assert each.ratio == pytest.approx(80 / (early + late), rel=1e-14)
        assert each.duration == pytest.approx((10 * early + 20 * late) / (early + late))
    assert not found.mature


def test_the_recovery_plan_is_worth_the_deficit():
    """Level payments over the six years of Fast Track, by the annuity's closed form; none without
    a deficit; three years at significant maturity; a broken number of years in proportion."""
    found = side_by_side(scheme(amount=40.0), due()).recovery
    annuity = (1 - 1.05**-6) / 0.05
    assert found.years == 6 and found.deficit > 0
    assert found.payment == pytest.approx(found.deficit / annuity, rel=1e-12)
    assert found.total == pytest.approx(6 * found.payment)
    assert side_by_side(scheme(amount=90.0), due()).recovery.payment == 0
    soon = due()._replace(years=np.arange(31.0) / 3, discount=1.04 ** -(np.arange(31.0) / 3))
    short = side_by_side(scheme(amount=40.0), soon)
    assert short.mature and short.recovery.years == 3
    part = side_by_side(scheme(amount=40.0, recovery_years=2.5), due()).recovery
    at = discounted(due(), 0.01)
    worth = at[1] + at[2] + 0.5 * (at[2] + at[3]) / 2
    assert part.payment == pytest.approx(found.deficit / worth, rel=1e-12)
    assert part.total == pytest.approx(2.5 * part.payment)


def test_payments_of_a_recovery_plan_are_money_if_pensions_follow_prices():
    """Gilts at 4 %, prices at 3 %, all continuous, a margin of 1 % over real rates: an amount of
    money is discounted at (exp(0.01) + 0.01) exp(0.03), the pension at exp(0.01) + 0.01."""
    one = replace(
        scheme(),
        curve=curve("zero_rate", [1.0, 60.0], [0.04, 0.04]),
        inflation=inflation(1, curve("break_even", [1.0, 60.0], [0.03, 0.03])),
        liability=Liability("risk-free", given("liability_rate", 0.0), "full"),
        cash_flows=cash_flows([150.0], [20]),
        plan=plan("advance"),
    )
    found = bases(one, {}).recovery
    real = np.exp(0.01) + 0.01
    assert found.deficit == pytest.approx(150 * real**-20 - 80, rel=1e-12)
    money = (real * np.exp(0.03)) ** -np.arange(1.0, 7.0)
    assert found.payment * money.sum() == pytest.approx(found.deficit, rel=1e-12)


def test_rules_have_a_date():
    with pytest.raises(CaseError, match="no version is in force on 2020-01-01"):
        scheme(datetime.date(2020, 1, 1))
    assert scheme().funding.margins["Low dependency"] == 0.005
    assert scheme(low_dependency=0.003).funding.margins["Low dependency"] == 0.003
