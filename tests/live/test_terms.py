"""Inputs in the terms of their owner."""

import datetime

import numpy as np
import pytest
from scipy import stats

from snapo.live.terms import Deltas, derivatives, handles, slopes, usual
from snapo.problem.inputs import Input
from snapo.solver.derivatives.interval import plain
from snapo.solver.derivatives.table import Sensitivities
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


def test_a_delta_by_month_is_the_sum_over_its_days_with_the_interval_of_that_sum():
    given, rng = curve(100), np.random.default_rng(0)
    found = Estimate(rng.normal(2.0, 1.0, (32, 100)))
    (table,) = derivatives(Deltas(None, {}, {"curve": found}), {"curve": given})
    march = found.blocks[:, 40:71].sum(1)
    assert table["rows"][2]["label"] == "2025-03"
    assert table["rows"][2]["value"] == pytest.approx(march.mean())
    half = stats.t.ppf(0.975, 31) * march.std(ddof=1) / 32**0.5
    assert table["rows"][2]["high"] == pytest.approx(march.mean() + half)
    assert table["rows"][2]["low"] == pytest.approx(march.mean() - half)
    assert table["effect"] == pytest.approx(0.5 * found.value.sum())


def test_a_delta_is_that_of_the_run_and_what_the_held_one_changes_by():
    """A held derivative of 3 that a bump refuted as 5 is 5 at the run's inputs; where the held one
    is 4, it is 6. The policy's error and both sides of a kink stay."""
    named, rng = {"a": Input(1.0)}, np.random.default_rng(1)
    noise = rng.normal(0.0, 0.1, 32)
    held = {"a": Estimate(3.0 + noise)}
    refuted = plain(Estimate(5.0 + noise), np.array(0.01), "through the policy")
    kink = refuted._replace(source="range", sides=(0.04, 0.06))
    for reported, sides in ((refuted, 0.0), (kink, 1.0)):
        run = Sensitivities(named, held, reported={"a": reported})
        (here,) = derivatives(Deltas(run, held, held), named)
        interval = reported.along(np.array(1.0))
        assert here["rows"][0]["value"] == pytest.approx(interval.value, rel=1e-12)
        assert here["rows"][0]["low"] == interval.low < 5.0 - sides
        moved = {"a": Estimate(4.0 + noise)}
        (there,) = derivatives(Deltas(run, held, moved), named)
        # The same noise in both: the change has no error of its own.
        for key in ("value", "low", "high"):
            assert there["rows"][0][key] == pytest.approx(here["rows"][0][key] + 1, rel=1e-9)
        others = {"a": Estimate(4.0 + rng.normal(0.0, 0.2, 32))}
        (there,) = derivatives(Deltas(run, held, others), named)
        wide = [x["rows"][0]["high"] - x["rows"][0]["low"] for x in (here, there)]
        assert wide[1] > wide[0] + 0.05


def test_an_input_that_the_run_does_not_know_has_its_held_derivative():
    named = {"a": Input(1.0), "b": Input([1.0, 2.0])}
    run = Sensitivities(
        named, {name: Estimate(np.ones((4, *x.value.shape))) for name, x in named.items()}
    )
    now = {"a": Estimate(np.full(4, 3.0)), "b": Estimate(np.full((4, 3), 2.0))}
    found = derivatives(
        Deltas(run, {"b": run.held["b"]}, now), {"a": named["a"], "b": Input(np.ones(3))}
    )
    assert [row["value"] for each in found for row in each["rows"]] == [3.0, 2.0, 2.0, 2.0]


def test_an_input_without_a_move_moves_by_a_share_of_itself():
    assert np.array_equal(usual(Input([2.0, -4.0])), [0.02, -0.04])


def test_first_order_without_sensitivities_is_nothing_and_else_what_the_run_believes():
    named = {"a": Input([1.0, 2.0])}
    assert np.array_equal(slopes(None, named)["a"], [0.0, 0.0])
    held = {"a": Estimate(np.full((32, 2), 3.0))}
    assert np.array_equal(slopes(Sensitivities(named, held), named)["a"], [3.0, 3.0])
