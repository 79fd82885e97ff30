"""The page of a back-test: its numbers are those of its tables."""

import datetime
import re
from html import unescape

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES

from snapo.case.load import load
from snapo.domains.gas_storage.history.hedged import HedgeDay, HedgedStore, HedgePosition
from snapo.domains.gas_storage.history.report import page
from snapo.domains.gas_storage.history.results import MarkedPosition, StoreBacktest
from snapo.domains.gas_storage.read.case import read_case

FIRST, ONE = datetime.date(2025, 1, 15), datetime.timedelta(1)


def result_of(count: int = 40, **changes) -> StoreBacktest:
    """A test of `count` days in two months with numbers that are added by hand: a flow of 1 on each
    day at the price of its number from 1, withdrawn from the 21st day on."""
    days = tuple(FIRST + n * ONE for n in range(count))
    spots, out = np.arange(1.0, count + 1), np.arange(count) >= 20
    sign = np.where(out, 1.0, -1.0)
    cash = sign * spots
    hedges = (HedgedStore("Daily, deltas", "months", 7.0, 2.0, 9.0, 397.0, 5.0),)
    fields = {
        "days": days,
        "spots": spots,
        "inventory": np.cumsum(-sign),
        "injection": 1.0 * ~out,
        "withdrawal": 1.0 * out,
        "cash": cash,
        "expected_cash": 0.5 * cash,
        "band": (np.cumsum(cash) - 50.0, np.cumsum(cash) + 50.0),
        "realised": 390.0,
        "expected": 400.0,
        "error": 2.0,
        "deviation": 30.0,
        "share": 0.4,
        "rolling": 380.0,
        "marks": (
            MarkedPosition(days[0], 0.0, 0.0, 400.0, 2.0, 300.0),
            MarkedPosition(days[min(20, count - 1)], 20.0, -210.0, 590.0, 1.0, 500.0),
        ),
        "mark_deviation": 12.0,
        "hedges": hedges,
        "hedge_days": (
            HedgeDay(FIRST - ONE, "Daily, deltas", "months", 1.0, 0.5, 3.0),
            HedgeDay(days[min(30, count - 1)], "Daily, deltas", "months", 8.0, 1.5, 6.0),
        ),
        "positions": tuple(
            HedgePosition(day, "Daily, deltas", "months", "2025-03", days[-1], days[-1], 2.0, 30.0)
            for day in days[:3]
        ),
    }
    return StoreBacktest(**fields | changes)


def html_of(result: StoreBacktest) -> str:
    return page(result, read_case(*load(CASES / "quick")), "prices")


def texts(result: StoreBacktest) -> str:
    html = re.sub(r"<(svg|style|script).*?</\1>", "", html_of(result), flags=re.S)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", html)))


@pytest.fixture(scope="module")
def whole() -> str:
    return texts(result_of())


def test_the_first_screen_has_the_result_and_its_expectation(whole):
    result = whole.partition("Cash flow over time")[0]
    assert "Realised EUR 390.000" in result
    assert "−10.000 ± 3.920 compared with the expectation; ± is half of a 95 % interval" in result
    assert "40 % of simulated histories earn less" in result
    assert "✓ within the range of 95 % of simulated histories" in result
    assert "Expected EUR 400.000 ± 3.920; standard deviation of one history 30" in result
    assert "Rolling intrinsic EUR 380.000" in result and "Intrinsic at start EUR 300" in result
    assert "A Daily, deltas: months +7.0000 397.00 5.000 9.0000 2.0000" in result


def test_months_add_up(whole):
    """January has the days of the prices 1 to 17; of 18 to 40 in February the last 20 are sold."""
    months = whole.partition("By month, discounted")[2]
    assert "2025-01 9.000 17.000 0.000 17.000 −153.00 −76.50 +0.5000" in months
    february = -(18 + 19 + 20) + sum(range(21, 41))
    assert f"2025-02 29.000 3.000 20.000 0.000 +{february}.00 +{february / 2}0 +6.5000" in months
    assert (
        "2025-02-04 20.000 −210.00 590.00 ± 1.96 380.00 500.00" in whole.partition("Solved on")[2]
    )


@pytest.mark.prove
def test_an_improbable_history_and_a_better_classical_method_are_named():
    text = texts(result_of(share=0.999, rolling=500.0))
    assert "✗ outside the range of 95 % of simulated histories" in text
    assert "✗ rolling intrinsic earned EUR 110.000 more" in text


@pytest.mark.prove
def test_without_curves_and_hedges_nothing_is_empty():
    result = result_of(rolling=None, hedges=(), hedge_days=(), positions=())
    plain = result_of(count=1, rolling=None, hedges=(), hedge_days=(), positions=(),
                   marks=result.marks[:1], mark_deviation=float("nan"))  # fmt: skip
    for one in (result, plain):
        text = texts(one)
        assert "Hedge" not in text and "Rolling" not in text and "nan" not in text
