"""The cash of a back-test with forced flows, which no model can move."""

import copy
import datetime
from pathlib import Path

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES

from snapo.case.error import CaseError
from snapo.case.load import load
from snapo.domains.gas_storage.history.backtest import run_backtest
from snapo.domains.gas_storage.history.observed import (
    ForwardQuote,
    ObservedMarket,
    read_observed,
)
from snapo.domains.gas_storage.history.rule import solved_on

FILE, DATA = load(CASES / "quick")
FIRST = datetime.date(2025, 1, 1)
SPOTS = 27.0, -8.0, -8.0


def forced(model, **contract):
    """A store that sells 5 on each of two days."""
    data = copy.deepcopy(dict(DATA)) | {"model": model}
    data["contract"] |= {"end": datetime.date(2025, 1, 3)}
    data["contract"] |= {"max_withdrawal": 5.0, "min_withdrawal": 5.0} | contract
    return data


def result(data, spots=SPOTS, curves=None, **options):
    days = tuple(FIRST + datetime.timedelta(n) for n in range(len(spots)))
    curves = {} if curves is None else curves
    seen = ObservedMarket(Path(), days, spots, tuple(sorted(curves)), curves)
    rule = solved_on(FILE, data, None, None, None)
    return run_backtest(FILE, data, seen, rule, options.pop("every", None), **options)


@pytest.mark.prove
@pytest.mark.parametrize("volatility", [0.0, 20.0])
def test_cash_has_the_observed_price(volatility):
    """Also where the model has no other price than the forward price."""
    model = {"kind": "one-factor-normal", "mean_reversion": 20.0, "volatility": volatility}
    exact = 5 * (27.0 - 0.05) + 5 * (-8.0 - 0.05) * np.exp(-0.03 / 365)
    assert result(forced(model)).realised == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("file", ["spot", "curves"])
def test_a_price_that_the_model_does_not_have_is_refused(tmp_path, file):
    model = {"kind": "one-factor-shifted", "mean_reversion": 20.0, "volatility": 0.9, "shift": 5.0}
    lowest = solved_on(FILE, forced(model), None, None, None).case.model.lowest
    price = {"spot": -4.9, "curves": -4.9} | {file: -5.0}
    (tmp_path / "spot.csv").write_text(f"date,price\n2025-01-01,{price['spot']}\n")
    rows = f"date,product,price\n2025-01-01,2025-02,{price['curves']}\n"
    (tmp_path / "curves.csv").write_text(rows)
    with pytest.raises(
        CaseError, match=rf"{file}\.csv, line 2, column price: got '-5.0'.*above -5, "
    ):
        read_observed(tmp_path, lowest, [])


@pytest.fixture
def costly(tmp_path):
    """The forced flows without volatility on days of 20 each, a curve on each day, and fixed costs
    of 50 today and 30 tomorrow."""
    model = {"kind": "one-factor-normal", "mean_reversion": 20.0, "volatility": 0.0}
    for name in ("curve.csv", "case.toml"):
        (tmp_path / name).write_text((CASES / "quick" / name).read_text())
    (tmp_path / "costs.csv").write_text("date,amount\n2025-01-01,50\n2025-01-02,30\n")
    days = [FIRST + datetime.timedelta(n) for n in range(3)]
    quotes = {day: [ForwardQuote(day, days[-1], 20.0)] for day in days[:2]}

    def run(**contract):
        data = forced(model, **contract)
        rule = solved_on(tmp_path / "case.toml", data, None, None, None)
        seen = ObservedMarket(tmp_path, tuple(days), (20.0,) * 3, tuple(quotes), quotes)
        return run_backtest(tmp_path / "case.toml", data, seen, rule, 1)

    return run


@pytest.mark.prove
def test_fixed_costs_move_no_mark(costly):
    """Prices stay at 20: every marked value is the cash flow of the whole test."""
    discount = np.exp(-0.03 / 365)
    cash = 5 * (20 - 0.05) * (1 + discount)
    for costs, fixed in ((None, 0.0), ("costs.csv", 50 + 30 * discount)):
        results = costly(**({} if costs is None else {"fixed_costs": costs}))
        assert len(results.marks) == 2
        first, second = results.marks
        values = [
            results.realised, results.expected, results.rolling, first.intrinsic, first.expected,
            second.cash + second.expected, second.cash + second.intrinsic,
        ]  # fmt: skip
        assert values == pytest.approx([cash - fixed] * len(values), abs=1e-6)
        assert results.mark_deviation == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("late", "hedge"),
    [(True, False), (True, True), (False, True)],
)
def test_curves_that_begin_late_are_refused(late, hedge):
    """In every mode; without any curve, hedges are."""
    model = {"kind": "one-factor-normal", "mean_reversion": 20.0, "volatility": 0.0}
    data, days = forced(model), [FIRST + datetime.timedelta(n) for n in range(3)]
    quotes = {days[1]: [ForwardQuote(days[1], days[2], 20.0)]} if late else {}
    message = r"curves\.csv, date:.* must begin on the valuation date, 2025-01-01, or earlier"
    with pytest.raises(CaseError, match=message):
        result(data, curves=quotes, hedge=hedge)
