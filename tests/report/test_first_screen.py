"""What the first screen and the menu of a report say, of every domain."""

import numpy as np
import pytest

from snapo.domains import control, energy, gas_storage, inventory, own, pension, pharma
from snapo.report.evidence import gradient, notes, spent
from snapo.report.folder import RunFiles, RunResult
from snapo.report.page import Headline, Section, Text
from snapo.report.quantity import until
from snapo.solver.verdict.further import room
from snapo.study.chapters.bound import optimum
from snapo.study.chapters.certificate import BumpRow, Certificate, LimitRow, bump_table, limit_table
from snapo.study.chapters.distribution import DISTRIBUTION, PLAIN, OutputTotal, OutputTotals
from snapo.study.chapters.headline import common_paths, headline
from snapo.study.domain import Report

BOUND = {
    "lower": {"value": 100.0, "standard_error": 0.1, "low": 99.8, "high": 100.2},
    "upper": {"value": 100.5, "standard_error": 0.1, "low": 100.3, "high": 100.7},
    "gap": {"value": 0.5, "standard_error": 0.05, "low": 0.4, "high": 0.6},
    "paths": 64,
}


def run(details=None, **entries) -> RunFiles:
    return RunFiles(RunResult(**entries), details or {}, {}, (), {}, {})


def plain(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


def test_the_bound_is_in_the_first_box_and_nowhere_else_on_the_first_screen():
    described = room(100.0, 0.1, BOUND).description
    assert (
        described
        == "At most 0.6 % can be gained over this policy: the optimum is at most 100.7 (95 %)."
    )
    files = run({"currency": "EUR", "bound": BOUND}, value=100.0, standard_error=0.1,
                notes=(described, "a note"))  # fmt: skip
    first = headline(files).blocks
    assert isinstance(first[0], Headline)
    assert (
        plain(first[0].context)
        == "Optimum: at most EUR 100.70 (95 %), 0.60 % away from the value of this policy."
    )
    assert first[0].error == "±\N{NO-BREAK SPACE}0.20"
    assert "± is half of a 95 % interval, simulation error only" in first[0].note
    assert [x.text for x in notes(files)] == ["a note"]


def test_a_bound_that_says_little_is_not_in_the_first_box():
    assert optimum(run({"bound": BOUND | {"says_little": "says little: a gap of 40"}})) == ""
    assert optimum(run()) == ""


def test_of_a_cost_the_bound_is_from_below():
    costs = {name: dict(x) for name, x in BOUND.items() if name != "paths"}
    for x in (costs["lower"], costs["upper"]):
        x |= {"value": x["value"] - 200, "low": x["low"] - 200, "high": x["high"] - 200}
    text = optimum(run({"bound": costs | {"paths": 64}}), cost=True)
    assert (
        plain(text)
        == "Lowest possible cost: at least 99.30 (95 %), 0.60 % away from the value of this policy."
    )


def test_the_policy_and_its_start_are_compared_on_common_paths():
    kept = run({"solution": {"selected": "start", "gain": -177.0, "gain_error": 32.0}})
    assert common_paths(kept)[0].text.endswith("on common paths their difference is 0.")
    gained = run(
        {"currency": "EUR", "solution": {"selected": "newest", "gain": 50.0, "gain_error": 10.0}}
    )
    assert plain(common_paths(gained)[0].text) == (
        "On common paths the policy earns EUR 50 ± 20 more than the rule that it began with."
    )
    assert common_paths(run()) == []


@pytest.mark.parametrize(
    ("norm", "noise", "value"),
    [(150.0, 100.0, "no more than noise"), (900.0, 100.0, "9.0 times its noise"),
     (0.0, 0.0, "no more than noise")],
)  # fmt: skip
def test_the_gradient_says_what_it_means(norm, noise, value):
    (name, text, meaning) = gradient(run(policy_gradient_norm=norm, policy_gradient_noise=noise))[0]
    assert (name, text) == ("Policy gradient", value)
    assert "would" in meaning and "optimum" not in meaning


def test_a_period_is_told_by_its_last_day():
    assert plain(until("2022-04-01")) == "31 March 2022"
    assert plain(until("2024-03-01")) == "29 February 2024"
    assert until("later") == "later"


def test_the_certificate_is_folded_with_its_largest_error():
    rows = (
        BumpRow("volatility", 3, 11.9, 18.5, True),
        BumpRow("price", 3, 0.1, 5.0, True),
        BumpRow("rate", 3, None, None, None),
    )
    table = bump_table(Certificate(rows), "EUR")
    assert table.folded == (
        "Adjoint compared with bumps: 2 of 2 agree; the error closest to its tolerance is 11.9 "
        "EUR, where 18.5 is allowed (Volatility)"
    )
    limits = (LimitRow("injection", -4.5e-13, 0, 0, True), LimitRow("room", 3.0, 0, 0, True))
    table = limit_table(Certificate((), limits), "MWh", "Day")
    assert table.folded == "Limits over all paths and days: 2 of 2 are met"
    assert [row[2] for row in table.rows] == ["0, up to rounding", "3"]
    broken = limit_table(Certificate((), (LimitRow("room", -3.0, 0, 0, False),)), "MWh", "Day")
    assert broken.rows[0][2] == "−3"


def test_one_total_of_seconds_without_the_page():
    seconds = {"training": 7.0, "report": 2.0, "total": 9.0}
    assert spent(run(seconds=seconds)) == {"training": 7.0, "total": 9.0}


DOMAINS = (control, energy, gas_storage, inventory, own, pension, pharma)


def reports(module) -> list[Report]:
    names = [
        name
        for name in vars(module)
        if name.endswith("DOMAIN") or name in ("SWING", "BATTERY", "PARK_AND_LOAN")
    ]
    return [getattr(module, name).report() for name in names]


@pytest.mark.parametrize("module", DOMAINS, ids=lambda module: module.__name__.split(".")[-1])
def test_every_domain_has_at_most_six_groups_and_all_begin_with_a_section(module):
    found = reports(module)
    assert found
    for report in found:
        assert 3 <= len(report.menu) <= 6
        assert all(first in report.sections for first in report.menu.values())
        order = [report.sections.index(first) for first in report.menu.values()]
        assert order == sorted(order)


def test_a_group_without_blocks_has_no_link_and_the_next_visible_section_is_linked():
    def empty(run):
        return Section("empty", "", "", [])

    def first(run):
        return Section("first", "First", "First", [Text("a")])

    def second(run):
        return Section("second", "Second", "Second", [Text("b")])

    report = Report("A", RunFiles, lambda run: [], (empty, first, second), {"Start": empty})
    made = [section(None) for section in report.sections]
    assert report.links(made) == [("first", "Start")]
    both = Report(
        "A", RunFiles, lambda run: [], (empty, first, second), {"None": empty, "End": first}
    )
    assert both.links(made) == [("first", "End")]
    plain = Report("A", RunFiles, lambda run: [], (empty, first, second))
    assert plain.links(made) == [("first", "First"), ("second", "Second")]


def test_a_plain_mean_that_differs_from_the_value_says_so():
    def texts(mean: float, objective: str) -> list[str]:
        total = OutputTotal(
            "cash", "EUR", 64, mean, 1.0, 0.1, 0.0, 0.1, {}, {}, np.arange(3.0), np.ones(2)
        )
        files = run({"objective": objective, "objective_output": "cash"}, value=100.0)
        return [
            x.text for x in DISTRIBUTION.show(files, OutputTotals((total,))) if isinstance(x, Text)
        ]

    assert texts(99.5, "mean of the discounted cash flow") == [PLAIN]
    assert texts(100.0, "mean of the discounted cash flow") == []
    assert texts(99.5, "cvar of the discounted cash flow") == []
    assert texts(5200.0, "mean of the result of a week") == []  # a sum over the weeks
