"""A value that is shown as another number: its error, changes and derivatives are in that unit."""

from types import SimpleNamespace

import numpy as np
import pytest

from snapo.live.headline import HeadlineTables
from snapo.study.study import DisplayedValue


def certain(value: float) -> DisplayedValue | None:
    """The certainty equivalent in % of the utility -1 / x."""
    return (
        DisplayedValue("Ratio", "%", -100 / value, 100 / value**2) if np.isfinite(value) else None
    )


def tables(headline=certain) -> HeadlineTables:
    units = lambda: {"unit": "", "units": {}}  # noqa: E731
    return HeadlineTables(SimpleNamespace(headline=headline, units=units))  # pyright: ignore


def value(value, change=0.0):
    return {
        "value": value, "standard_error": 0.01, "change": change, "change_error": 0.001,
        "predicted": change, "by_input": {"x": change}, "paths": 8,
    }  # fmt: skip


def test_values_changes_and_errors_are_those_of_the_headline():
    shown = tables()
    base = shown.table("value", value(-1.0))
    assert (base["value"], base["standard_error"], base["change"]) == (100.0, 1.0, 0.0)
    assert shown.units() == {"unit": "%", "units": {}, "meaning": "Ratio"}
    assert shown.inputs([{"slope": np.array([2.0])}, {"slope": None}])[0]["slope"] == 200.0
    moved = shown.table("value", value(-0.8, 0.2))
    assert moved["value"] == pytest.approx(125.0) and moved["change"] == pytest.approx(25.0)
    assert moved["by_input"] == {"x": pytest.approx(20.0)} and moved["paths"] == 8
    row = {"input": "x", "effect": 0.1, "low": None, "rows": [{"value": 0.1, "label": "a"}]}
    (delta,) = shown.table("deltas", [row])
    slope = 100 / 0.64  # at the value that is shown
    assert delta["effect"] == delta["rows"][0]["value"] == pytest.approx(0.1 * slope)
    assert delta["low"] is None


def test_steps_add_up_and_a_bound_is_a_ratio():
    shown = tables()
    shown.table("value", value(-1.0))
    steps = [{"names": [x], "change": by, "error": 0.0} for x, by in (("a", 0.3), ("b", -0.1))]
    changes = [row["change"] for row in shown.table("explained", steps)]
    assert sum(changes) == pytest.approx(25.0) and changes[0] > 25.0
    estimate = lambda x: {"value": x, "standard_error": 0.01}  # noqa: E731
    bound = {"lower": estimate(-1.0), "upper": estimate(-0.8), "gap": estimate(0.2)}
    bounded = shown.table("bounded", bound)
    assert bounded["upper"]["value"] == pytest.approx(125.0)
    assert bounded["gap"]["value"] == pytest.approx(25.0)
    trained = {"value": -0.8, "standard_error": 0.01, "gain": 0.2, "gain_error": 0.01, "steps": 3}
    assert shown.table("trained", trained)["gain"] == pytest.approx(25.0)


def test_without_a_headline_tables_stay_as_they_are():
    shown = tables(lambda value: None)
    table = value(-1.0)
    assert shown.table("value", table) is table and shown.units()["unit"] == ""
    assert tables().table("value", value(float("nan")))["value"] is not None
