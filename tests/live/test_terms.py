"""Inputs in the terms of their owner."""

import datetime

import numpy as np
import pytest

from snapo.live.terms import derivatives, handles, slopes, usual
from snapo.problem.inputs import Input
from snapo.solver.sensitivity import Sensitivities
from snapo.solver.statistics import Estimate


def curve(days):
    first = datetime.date(2025, 1, 20)
    labels = [first + datetime.timedelta(k) for k in range(days)]
    return Input(np.ones(days), "EUR/MWh", labels, move=0.5)


def test_many_days_are_moved_by_month_and_few_by_themselves():
    found = handles(curve(100))
    assert [label for label, _ in found] == ["2025-01", "2025-02", "2025-03", "2025-04"]
    assert [len(at) for _, at in found] == [12, 28, 31, 29]
    assert [i for _, at in found for i in at] == list(range(100))
    assert len(handles(curve(30))) == 30
    assert handles(Input(np.ones((100,)), labels=range(100)))[99] == ("99", [99])
    assert handles(Input(3.0)) == [("", [0])]
    powers = handles(Input([1.0, 2.0], labels=("t^0", "t^1")))
    assert [label for label, _ in powers] == ["t⁰", "t¹"]


def test_a_delta_by_month_is_the_sum_over_its_days_with_the_error_of_that_sum():
    given, rng = curve(100), np.random.default_rng(0)
    found = Estimate(rng.normal(2.0, 1.0, (32, 100)))
    (table,) = derivatives({"curve": found}, {"curve": given})
    march = found.blocks[:, 40:71].sum(1)
    assert table["rows"][2]["label"] == "2025-03"
    assert table["rows"][2]["value"] == pytest.approx(march.mean())
    assert table["rows"][2]["standard_error"] == pytest.approx(march.std(ddof=1) / 32**0.5)
    assert table["effect"] == pytest.approx(0.5 * found.value.sum())


def test_an_input_without_a_move_moves_by_a_share_of_itself():
    assert np.array_equal(usual(Input([2.0, -4.0])), [0.02, -0.04])


def test_first_order_without_sensitivities_is_nothing_and_else_what_the_run_believes():
    named = {"a": Input([1.0, 2.0])}
    assert np.array_equal(slopes(None, named)["a"], [0.0, 0.0])
    held = {"a": Estimate(np.full((32, 2), 3.0))}
    assert np.array_equal(slopes(Sensitivities(named, held), named)["a"], [3.0, 3.0])
