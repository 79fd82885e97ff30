"""Which products a hedge holds overnight, and the table [hedge]."""

import datetime
import json
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import SMALL, read, with_table

from snapo.case.error import CaseError
from snapo.domains.gas_storage.chapters import hedge
from snapo.domains.gas_storage.chapters.run import StorageRun
from snapo.domains.gas_storage.hedges import DELTAS, MIN_VARIANCE, DailyHedge, usual_hedges
from snapo.domains.gas_storage.hedges.held import Overnight
from snapo.domains.gas_storage.ladder.products import TradedProducts, usual_products
from snapo.domains.gas_storage.setup import bare_problem
from snapo.report.page import Text
from snapo.study import commands
from snapo.study.domain import CaseRequest
from snapo.study.study import StudyRun

FIRST = datetime.date(2009, 4, 1)
DAYS = tuple(FIRST + datetime.timedelta(n) for n in range(365))
DAY_AHEAD, BALANCE, MONTHS = "day_ahead", "balance_of_month", "months"


def held(t: int, *families: str) -> list[tuple[str, int, int]]:
    rows = Overnight(usual_products(DAYS, FIRST)).held(t, families)
    return [(row.name, row.block.first, row.block.after) for row in rows]


def nearest(t: int, *families: str) -> list[tuple[int, int]]:
    rows = Overnight(usual_products(DAYS, FIRST)).nearest(t, families)
    return [(row.block.first, row.block.after) for row in rows]


def test_a_month_alone_is_closed_on_its_last_trading_day():
    assert held(28, MONTHS)[0] == ("2009-05", 30, 61)  # 29 April
    assert held(29, MONTHS)[0] == ("2009-06", 61, 91)  # 30 April: May ends to trade
    assert held(30, MONTHS)[0] == ("2009-06", 61, 91)


def test_the_balance_of_the_month_follows_the_month():
    assert held(28, BALANCE, MONTHS)[:2] == [
        ("balance of 2009-04", 29, 30),
        ("2009-05", 30, 61),
    ]
    assert held(29, BALANCE, MONTHS)[0] == ("2009-05", 30, 61)
    assert held(30, BALANCE, MONTHS)[0] == ("balance of 2009-05", 31, 61)


def test_tomorrow_belongs_to_the_day_ahead():
    names = [("day ahead", 30, 31), ("2009-05", 31, 61), ("2009-06", 61, 91)]
    assert held(29, DAY_AHEAD, BALANCE, MONTHS)[:3] == names
    assert held(29, DAY_AHEAD, MONTHS)[:2] == [names[0], names[2]]
    assert held(10, DAY_AHEAD) == [("day ahead", 11, 12)]
    assert held(364, DAY_AHEAD, BALANCE, MONTHS) == []


def test_all_later_days_are_covered_once():
    for t in range(364):
        days = [d for _, first, after in held(t, DAY_AHEAD, BALANCE, MONTHS)
                for d in range(first, after)]  # fmt: skip
        assert days == list(range(t + 1, 365))


def test_the_balance_takes_the_place_of_the_next_month_in_the_last_one():
    assert nearest(29, MONTHS) == [(61, 91)]
    assert nearest(340, MONTHS) == [(341, 365)]
    assert nearest(340, DAY_AHEAD, MONTHS) == [(341, 342), (342, 365)]
    assert nearest(340, DAY_AHEAD) == [(341, 342)]


def test_before_delivery_everything_trades_on_the_valuation_date():
    overnight = Overnight(usual_products(DAYS, datetime.date(2009, 2, 1)))
    assert overnight.first == -1
    rows = overnight.held(-1, (DAY_AHEAD, BALANCE, MONTHS))
    assert [row.block.first for row in rows][:2] == [0, 30]
    eve = Overnight(usual_products(DAYS, datetime.date(2009, 3, 31)))
    assert eve.held(-1, (DAY_AHEAD, BALANCE, MONTHS))[0].block[:2] == (0, 1)


def test_hedges_without_a_table():
    hedges = usual_hedges((DAY_AHEAD, BALANCE, MONTHS))
    assert [x.families for x in hedges if x.rule == DELTAS] == [
        (MONTHS,), (BALANCE, MONTHS), (DAY_AHEAD, BALANCE, MONTHS),
    ]  # fmt: skip
    assert [x.families for x in hedges if x.rule == MIN_VARIANCE] == [
        (DAY_AHEAD,), (MONTHS,), (DAY_AHEAD, MONTHS),
    ]  # fmt: skip
    assert usual_hedges((DAY_AHEAD,)) == (
        DailyHedge(DELTAS, (DAY_AHEAD,)),
        DailyHedge(MIN_VARIANCE, (DAY_AHEAD,)),
    )


def test_families_of_products():
    case = read("G6", products={"quarters": {}, "months": {"ahead": 1}})
    assert isinstance(case.products, TradedProducts)
    assert case.products.families == (DAY_AHEAD, MONTHS, "quarters")
    rows = Overnight(case.products).held(3, ("quarters",))
    assert {row.family for row in rows} == {"quarters"}


def test_a_table_of_hedges():
    sets = {"deltas": [["months", "day_ahead"]], "least_variance": [], "paths": 512}
    hedges = read("G6", hedge=sets).hedges
    assert hedges is not None and hedges.paths == 512
    assert hedges.daily == (DailyHedge(DELTAS, (DAY_AHEAD, MONTHS)),)
    assert read("G6").hedges is None
    usual = read("G6", hedge={}).hedges
    assert usual is not None and usual.daily == usual_hedges((DAY_AHEAD, BALANCE, MONTHS))


@pytest.mark.parametrize(
    ("table", "where", "allowed"),
    [
        ({"delta": []}, "hedge.delta", "nearest known key is deltas"),
        ({"deltas": [["month"]]}, "hedge.deltas", '"months"'),
        ({"deltas": [["quarters"]]}, "hedge.deltas", "the traded keys of [products]"),
        ({"deltas": [[]]}, "hedge.deltas", "at least one product"),
        ({"deltas": ["months"]}, "hedge.deltas", "list"),
        ({"paths": 10}, "hedge.paths", "256"),
    ],
)
def test_mistakes_are_named(table, where, allowed):
    with pytest.raises(CaseError) as caught:
        read("G6", hedge=table)
    assert where in str(caught.value) and allowed in str(caught.value)


def test_a_kind_without_a_hedge_refuses_it(tmp_path):
    commands.new("control", tmp_path / "case")
    with pytest.raises(CaseError, match="no hedge to simulate"):
        commands.solve(CaseRequest(tmp_path / "case"), lambda _: None, hedge=True)


def test_prices_without_a_curve_on_paths_have_no_hedge():
    """D1 has spikes: the report says why."""
    case = read("D1")
    setup = SimpleNamespace(problem=bare_problem(case), case=case)
    result = hedge.measure(cast(StudyRun, SimpleNamespace(setup=setup)))
    assert not result.hedges and "paths have no forward curve" in result.reason
    (block,) = hedge.show(cast(StorageRun, None), result)
    assert isinstance(block, Text) and result.reason in block.text


@pytest.mark.prove
def test_a_run_simulates_its_hedges(tmp_path):
    """CSV, JSON and report; the full set of products removes most of the variance, and means differ
    from the value by their errors."""
    case, out = with_table("G6", "[hedge]\npaths = 2048", tmp_path / "case"), tmp_path / "out"
    printed: list[str] = []
    result = commands.solve(CaseRequest(case, SMALL), printed.append, out=out, hedge=True)
    table = json.loads((out / "parts" / "hedge.json").read_text())["hedge"]
    rows = {(row["hedge"], row["products"]): row for row in table["hedges"]}
    assert len(rows) == 11 and table["paths"] == 2048 and not table["reason"]
    full = rows["Daily, deltas", "day ahead, balance of month, months"]
    bare = rows["None", ""]
    assert full["not_hedged"] < 0.3 and bare["not_hedged"] == 1
    assert full["deviation"] ** 2 / bare["deviation"] ** 2 == pytest.approx(full["not_hedged"])
    for row in rows.values():
        assert (
            abs(row["mean"] - result["value"])
            < 4 * row["mean_error"] + 3 * result["standard_error"]
        )
        assert 0 < row["value_at_risk"] < row["expected_shortfall"] and row["cost"] == 0
    products = [row for row in table["by_product"] if row["products"] == full["products"]]
    assert [row["product"] for row in products] == ["day ahead", "balance of month", "months"]
    assert all(np.isfinite([row["single"], row["without"]]).all() for row in products)
    lines = (out / "hedge.csv").read_text().splitlines()
    assert lines[0].startswith("hedge,products,mean,mean_error") and len(lines) == 12
    assert (out / "hedge_products.csv").read_text().startswith("hedge,products,product,single")
    assert "Profit and loss with a hedge" in (out / "report.html").read_text()
    assert any(line.startswith("hedge: None: standard deviation") for line in printed)
