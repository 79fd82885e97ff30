"""What a case names in [products], and the days that each trades."""

import datetime
import json
from itertools import pairwise

import numpy as np
import pytest
from tests.domains.gas_storage.storage_cases import CASES, SMALL, read, with_table

from snapo.case.error import CaseError
from snapo.domains.gas_storage.ladder.products import TradedProduct, TradedProducts, usual_products
from snapo.study import commands
from snapo.study.domain import CaseRequest

D = datetime.date
EVERYTHING = {
    "day_ahead": {"bid_offer": 0.05},
    "balance_of_month": {"bid_offer": 0.1},
    "months": {"bid_offer": 0.2, "lot": 5.0, "ahead": 2},
    "quarters": {"ahead": 2},
    "seasons": {"bid_offer": 0.3},
}


def names(products: TradedProducts, t: int) -> list[str]:
    return [name for name, _ in products.named(t)]


def test_each_day_belongs_to_the_shortest_product_that_trades():
    case = read("G6", products=EVERYTHING)
    products = case.products
    assert products is not None
    assert names(products, 0) == [
        "day ahead", "balance of 2009-04", "2009-05", "2009-06", "2009-Q3", "2009-Q4",
        "winter 2009",
    ]  # fmt: skip
    rows = dict(products.named(0))
    assert rows["day ahead"] == (0, 1, 0.025, 0.0, True)
    assert rows["2009-05"] == (30, 61, 0.1, 5.0, True)
    assert rows["winter 2009"].spread == 0.15 and rows["winter 2009"].after == 365
    for t in range(365):
        blocks = products.blocks(t)
        assert blocks[0][:2] == (t, t + 1) and blocks[-1].after == 365
        assert all(one.after == other.first for one, other in pairwise(blocks))


def test_months_trade_until_the_day_before_they_begin():
    products = read("G6", products={"months": {}}).products
    assert products is not None
    assert names(products, 29)[:3] == ["day ahead", "2009-05", "2009-06"]
    assert names(products, 28)[1:3] == ["", "2009-05"]  # no balance of month: 30 April is left
    assert names(products, 30)[:3] == ["day ahead", "", "2009-06"]


def test_without_a_table_months_and_the_balance_of_month_trade_free_of_cost():
    days = read("G6").days
    products = usual_products(days, days[0])
    assert names(products, 0)[:3] == ["day ahead", "balance of 2009-04", "2009-05"]
    assert all(block.spread == 0 and block.trades for block in products.blocks(0))
    assert read("G6").products is None


def test_the_valuation_date_trades_before_the_first_delivery():
    days = tuple(D(2026, 5, 10) + datetime.timedelta(n) for n in range(30))
    products = usual_products(days, D(2026, 4, 20))
    assert products.before
    assert names(products, -1) == ["2026-05", "2026-06"]
    assert products.blocks(-1)[0][:2] == (0, 22)


def test_products_of_a_file(tmp_path):
    (tmp_path / "curve.csv").write_text((CASES / "G6" / "curve.csv").read_text())
    (tmp_path / "more.csv").write_text(
        "name,first,last,bid_offer,lot,last_trading_day\n"
        "first half,2009-05-01,2009-05-15,0.1,0,2009-04-28\n"
    )
    (tmp_path / "case.toml").write_text(
        (CASES / "G6" / "case.toml").read_text()
        + '\n[products]\nmonths = { ahead = 20 }\nothers = "more.csv"\n'
    )
    from tests.domains.gas_storage.storage_cases import read_case

    with pytest.raises(CaseError, match="2009-05"):  # May as a whole, after its half has traded
        read_case(tmp_path)


@pytest.mark.parametrize(
    ("table", "where", "allowed"),
    [
        ({"month": {}}, "products.month", "nearest known key is months"),
        ({"months": {"bid_offer": -0.1}}, "products.months.bid_offer", "at least 0"),
        ({"months": {"ahead": 0}}, "products.months.ahead", "1 or more"),
        ({"others": "none.csv"}, "products.others", "no such file"),
        ({"day_ahead": 0.1}, "products.day_ahead", "a table"),
    ],
)
def test_mistakes_are_named(table, where, allowed):
    with pytest.raises(CaseError) as caught:
        read("G6", products=table)
    assert where in str(caught.value) and allowed in str(caught.value)


def test_a_product_opens_and_ends():
    product = TradedProduct(
        "x", D(2026, 5, 1), D(2026, 5, 31), 0.0, 0.0, D(2026, 4, 29), D(2026, 3, 1)
    )
    assert not product.trades(D(2026, 2, 28)) and product.trades(D(2026, 3, 1))
    assert product.trades(D(2026, 4, 29)) and not product.trades(D(2026, 4, 30))


@pytest.mark.prove
def test_a_run_compares_methods_and_reports_deltas_by_product(tmp_path):
    """The deltas sum to those by day; the methods are in their order, in CSV, JSON and report."""
    case, out = (
        with_table("G6", "[products]\nmonths = { bid_offer = 0.1 }", tmp_path / "case"),
        tmp_path / "out",
    )
    printed: list[str] = []
    commands.solve(CaseRequest(case, SMALL), printed.append, out=out, ladder=True)
    part = json.loads((out / "parts" / "deltas-by-product.json").read_text())
    rows = part["deltas_by_product"]
    assert [row["product"] for row in rows] == ["day ahead", "no product yet", "2009-05", "2009-06"]
    daily = json.loads((out / "parts" / "deltas.json").read_text())["deltas_daily"]
    for name in ("discounted", "undiscounted"):
        assert sum(row[name] for row in rows) == pytest.approx(sum(daily[name]), rel=1e-9, abs=1e-9)
    assert all(row["low"] <= row["discounted"] <= row["high"] for row in rows)
    assert (out / "products.csv").read_text().startswith("product,first,last,days,discounted")
    methods = json.loads((out / "parts" / "methods.json").read_text())["methods"]
    values = {row["method"]: row["value"] for row in methods["methods"]}
    assert len(values) == 8 and not methods["missing"] and not methods["warnings"]
    assert values["Intrinsic in products"] <= values["Intrinsic by day"] + 1e-9
    assert values["Intrinsic by day"] < values["Rolling intrinsic"] < values["Lattice"]
    assert values["Upper bound"] <= values["Perfect foresight"]
    shares = {row["method"]: row["share"] for row in methods["methods"]}
    assert shares["Intrinsic by day"] == 0 and shares["Lattice"] == 1
    lines = (out / "ladder.csv").read_text().splitlines()
    assert lines[0].startswith("method,value,standard_error,seconds,share,difference")
    assert len(lines) == 9 and "None" not in lines[1]
    page = (out / "report.html").read_text()
    assert "Methods side by side" in page and "Deltas by traded product" in page
    assert np.isfinite(list(values.values())).all()


def test_a_kind_without_methods_refuses_the_ladder(tmp_path):
    commands.new("control", tmp_path / "case")
    with pytest.raises(CaseError, match="no methods to compare"):
        commands.solve(CaseRequest(tmp_path / "case"), lambda _: None, ladder=True)
