"""Sums of a book: of values, changes and derivatives, with errors from common paths."""

import numpy as np
import pytest
from tests.book.books import results_of

from snapo.book.collect import position, tables
from snapo.book.folder import BookFolder
from snapo.book.run import plan_of
from snapo.book.sums import BookTotal, risks
from snapo.solver import statistics


def members(valued):
    plan, folder = plan_of(valued.book), BookFolder(valued.out)
    return {x.name: position(plan, x, folder, {}) for x in valued.book.contracts}


def row(result, stress):
    return next(x for x in result["sums"] if x["stress"] == stress)


def test_twins_are_computed_once(valued):
    assert valued.result["orders"] == {"computed": 2, "reused": 0, "lost": 0}
    results = results_of(valued.book, valued.out)
    assert results["first"].pack() == results["twin"].pack() == results["sold"].pack()


def test_a_contract_and_its_twin_double_the_error(valued):
    """Their paths are the same worlds: errors of 1 + 1 add, and 1 + 1 - 2 leaves nothing."""
    one = members(valued)["first"].base
    both = BookTotal("base")
    both.add("", {"base": one.shares})
    both.add("", {"base": one.shares})
    result = both.at("base")
    assert result is not None
    assert result.standard_error == pytest.approx(2 * one.standard_error, rel=1e-9)
    both.add("", {"base": -2 * one.shares})
    nothing = both.at("base")
    assert nothing is not None and nothing.value == 0.0 and nothing.standard_error == 0.0


def test_the_sum_is_that_of_positions(valued):
    """1 + 1 - 2 of one contract, and three of the other: the sum is three of the other."""
    dearer = members(valued)["dearer"]
    for stress in ("base", "up 10 %", "dear injection"):
        point, base = dearer.points[stress][0], dearer.base
        result, change = (
            row(valued.result, stress),
            statistics.of_shares(point.shares - base.shares),
        )
        assert result["value"] == pytest.approx(3 * point.value, rel=1e-12)
        assert result["standard_error"] == pytest.approx(3 * point.standard_error, rel=1e-9)
        assert result["change"] == pytest.approx(3 * change.value, rel=1e-9, abs=1e-12)
        assert result["change_error"] == pytest.approx(3 * change.standard_error, rel=1e-9)


def test_columns_split_the_sum(valued):
    desks = valued.result["by"]["desk"]
    total = sum(rows[0]["value"] for rows in desks.values())
    assert total == pytest.approx(row(valued.result, "base")["value"], rel=1e-12)


def test_derivatives_add_up(valued):
    dearer = members(valued)["dearer"]
    expected = {x.input: 3 * x.blocks.mean(0).sum() for x in dearer.base.deltas}
    for name, value in expected.items():
        rows = [x for x in valued.result["deltas"] if x["input"] == name]
        assert sum(x["held"] for x in rows) == pytest.approx(value, rel=1e-12, abs=1e-12)


def test_derivatives_explain_a_small_change(valued):
    """The cost of injection rises by 0.05: decisions change little, so that the held derivative
    explains it but for what the policy saves."""
    result = row(valued.result, "dear injection")
    assert result["explained"] < 0
    assert result["explained"] + result["unexplained"] == pytest.approx(result["change"], rel=1e-12)
    member = members(valued)["dearer"]
    delta = next(x for x in member.base.deltas if x.input == "injection_cost")
    assert result["explained"] == pytest.approx(3 * 0.05 * delta.blocks.mean(0).sum(), rel=1e-9)


def test_a_quantity_scales_all_tables(valued):
    """-2 of a contract beside 1 of it: values, shares and derivatives times -2, errors times 2."""
    sold, first = (tables(members(valued)[name]) for name in ("sold", "first"))
    for table, column, factor in (
        ("values", "value", -2),
        ("values", "standard_error", 2),
        ("values", "change", -2),
        ("values", "explained", -2),
        ("shares", "share", -2),
        ("deltas", "held", -2),
        ("deltas", "held_error", 2),
    ):
        np.testing.assert_allclose(
            sold[table][column], factor * np.array(first[table][column]), rtol=1e-12
        )


def test_independent_markets_add_in_squares():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 512))
    total = BookTotal("base")
    total.add("a", {"base": x})
    total.add("b", {"base": y})
    result = total.at("base")
    errors = [statistics.of_shares(z).standard_error for z in (x, y)]
    assert result is not None and result.value == pytest.approx(x.mean() + y.mean())
    assert result.standard_error == pytest.approx(np.hypot(*errors))


def test_contracts_of_other_worlds_have_no_error_together():
    """Path p of one is not path p of the other: neither a common sum nor one of squares is right."""
    x = np.random.default_rng(0).normal(size=512)
    total = BookTotal("base")
    total.add("a", {"base": x}, "counted from 1 January")
    total.add("a", {"base": x}, "counted from 1 February")
    result = total.at("base")
    assert result is not None and result.value == pytest.approx(2 * x.mean())
    assert result.standard_error is None and result.change_error is None
    assert total.mean_change(["base"]) == (0.0, None)


def test_the_interval_covers_the_truth():
    """Of 400 books of correlated contracts with a mean of nothing, 95 % intervals hold nothing
    370 to 390 times (two standard deviations of a binomial number are 9)."""
    rng, covered = np.random.default_rng(1), 0
    for _ in range(400):
        world = rng.normal(size=512)
        total = BookTotal("base")
        for quantity in (1.0, -3.0, 2.0):
            total.add("", {"base": quantity * (world + rng.normal(size=512))})
        result = total.at("base")
        assert result is not None
        covered += abs(result.value) < 1.965 * result.standard_error
    assert 370 <= covered <= 390


def test_value_at_risk_of_scenarios():
    """100 stresses that lose 1 to 100: 95 % loses 96, and 98 beyond it on average."""
    total = BookTotal("base")
    shares = {f"{i}": np.full(8, -float(i)) for i in range(1, 101)}
    total.add("", {"base": np.zeros(8), **shares})
    at_95, at_99 = risks(total, list(shares))
    assert (at_95.level, at_95.var, at_95.shortfall) == (0.95, 96.0, 98.0)
    assert (at_99.level, at_99.var, at_99.shortfall) == (0.99, 100.0, 100.0)
    assert risks(total, list(shares)[:10]) == []
