"""The report of a pension run: from the files of a run folder, whatever is missing in them."""

import json
import re
from copy import deepcopy
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from snapo.domains.pension import DOMAIN
from snapo.domains.pension.chapters import sensitivities
from snapo.domains.pension.chapters.outputs import OUTPUTS
from snapo.domains.pension.chapters.sensitivities import InputEffect, NumberEffect
from snapo.domains.pension.chapters.stress import _signed
from snapo.domains.pension.report import SECTIONS
from snapo.domains.pension.results.study import in_classes
from snapo.domains.pension.run import PensionRun
from snapo.report.bands import Layer, stack
from snapo.report.page import Table
from snapo.report.quantity import number
from snapo.study import carry_out
from snapo.study.run_folder import plain_json

YEARS = 10
CLASSES = ("Cash", "Bonds 10y", "Bonds 20y", "Credit BBB", "Equity", "Property")
NODES = (1.0, 5.0, 10.0, 20.0, 30.0, 50.0)
RESULT = {"kind": "pension", "value": -0.18, "standard_error": 0.0004, "status": "trained"}


def fan(centre: np.ndarray, width: float) -> dict:
    names = ("p01", "p05", "p25", "p50", "p75", "p95", "p99")
    shifts = (-2.3, -1.6, -0.7, 0.0, 0.7, 1.6, 2.3)
    spread = width * np.sqrt(np.arange(len(centre)) + 1e-3)
    return {name: centre + s * spread for name, s in zip(names, shifts)} | {"mean": centre + 0.01}


def outputs() -> dict:
    """Effects of one input on two outputs."""
    every = [
        {"key": "funding", "name": "Mean funding ratio", "money": False, "value": 1.15}
        | {"error": 0.003},
        {"key": "contributions", "name": "PV of contributions", "money": True, "value": 6e7}
        | {"error": 3e5},
    ]
    effects = {"funding": [0.0123, 2e-4], "contributions": [-5e5, 1e4]}
    family = {"input": "zero_rate", "move": "1 bp", "count": 6, "effects": effects}
    family |= {"group": "curve", "words": "the zero rate at one node"}
    return {"outputs": every, "families": [family], "rows": []}


def sample() -> dict:
    """Figures such as a run writes, made up."""
    time, flow = np.arange(YEARS + 1), 9e6 * np.exp(-((np.arange(60) - 14) ** 2) / 500)
    weights = np.array([0.02, 0.25, 0.15, 0.13, 0.35, 0.1])
    target = np.array([0.0, 0.31, 0.2, 0.14, 0.28, 0.07])
    trades = [
        {"name": name, "now": a, "target": b, "low": 0, "high": 0.7, "trade": (b - a) * 262e6}
        | {"cost": abs(b - a) * 3e4}
        for name, a, b in zip(CLASSES, weights, target)
    ]
    ladder = {"label": [f"{n:g}y" for n in NODES], "tenor": NODES, "quote": "zero"}
    ladder["liability"] = -np.array([5e2, 4e3, 2e4, 9e4, 1.2e5, 6e4])
    after = ladder | {"assets": -np.array([0, 0, 9e4, 1e5, 0, 0]), "swaps": np.zeros(6) - 1e4}
    row = {"input": "zero_rate", "move": "1 bp", "standard_error": 2e-5, "reacting": 1.5e-4}
    row |= {"group": "curve", "words": "KR01: the zero rate at one node"}
    rows = [row | {"label": label, "effect": 1e-4} for label in ladder["label"]]
    family = row | {"effect": 6e-4, "count": 6}
    equity = family | {"input": "asset_mean", "effect": 0.02, "count": 2, "group": "premium"}
    life = "all death rates fall until its life expectancy at 65 is a year longer"
    life = {"input": "year_of_life", "move": "1 year", "effect": -0.03, "words": life}
    policies = [
        {"key": key, "name": name, "value": value, "equivalent": ratio, "lead": lead}
        | {"lead_error": 1e-4, "difference": 0.01, "difference_error": 1e-3, "median": 1.2}
        | {"p05": 0.8 + lead, "underfunded": 0.2, "pv_contribution": 4e7 + 1e9 * lead}
        for key, name, value, ratio, lead in (
            ("learned", "Learned policy", -0.18, 1.09, 0.0),
            ("constant_mix", "Constant mix", -0.19, 1.07, 0.002),
            ("glide_path", "Glide path", -0.185, 1.08, 0.001),
        )
    ]
    point = {"share": 0.0, "contributions": 4e7, "contributions_error": 1e5, "cvar": -0.2}
    point |= {"cvar_error": 0.004, "median": 1.1, "underfunded": 0.2, "efficient": True}
    lines = [
        {"name": "liability", "own": 2.5e8, "given": 2.5e8, "error": 1e-9, "ok": True},
        {"name": "duration", "own": 18.2, "given": None, "error": None, "ok": None},
    ]
    martingale = {"name": "Discount factor at the horizon", "own": 0.79, "expected": 0.791}
    return {
        "title": "A small pension fund",
        "currency": "EUR",
        "valuation_date": "2024-12-31",
        "measure": "P",
        "years": YEARS,
        "steps": 12 * YEARS,
        "step": 1 / 12,
        "notes": ["A remark."],
        "model": "Hull-White, one factor.",
        "held": ["asset_cost"],
        "assets": 262e6,
        "liability": 250e6,
        "funding": 1.048,
        "reconciliation": {
            "lines": lines,
            "liability": 250e6,
            "duration": 18.2,
            "convexity": 480.0,
            "inflation01": 3e5,
            "key_rate_durations": {"label": ladder["label"], "years": np.full(6, 18.2 / 6)},
            "cash_flow": flow,
        },
        "market_consistency": [martingale | {"standard_error": 1e-3, "ok": True}],
        "by_year": {
            "years": time,
            "funding": fan(1.05 + 0.01 * time, 0.08),
            "underfunded": 0.3 - 0.01 * time,
            "shortfall": -0.02 * time,
            "contribution": fan(6e6 + 1e5 * time[1:], 4e5),
            "benefit": fan(1e7 + 1e5 * time[1:], 2e5),
            "indexation": fan(0.015 + 0 * time[1:], 0.002),
            "cumulated": fan(1.015 ** time[1:], 0.01),
        },
        "policy_map": {
            "years": time[:-1],
            "ratios": [0, 0.9, 1.0, 1.1, 1.3, None],
            "growth": [[None, 0.2, 0.3, 0.4, 0.5]] * YEARS,
            "hedge": [[0.9, 0.8, 0.7, 0.5, None]] * YEARS,
        },
        "mix": {
            "years": time[:-1],
            "classes": CLASSES,
            "weights": np.repeat(target[:, None], YEARS, 1),
            "overlay": np.full((2, YEARS), 0.4),
        },
        "limits": {
            "weights": {"share": np.zeros(120), "ever": 0.0},
            "collateral": {"share": np.linspace(0, 0.01, 120), "ever": 0.02},
        },
        "first_decision": {"weights": target, "overlay": [0.4, 0.4]},
        "recorded_paths": 4096,
        "trades": {
            "classes": trades,
            "swaps": [{"tenor": "30y", "now": 0.0, "target": 4e7, "trade": 4e7}],
        },
        "ladder": ladder | {"assets": after["assets"] / 2, "swaps": np.zeros(6)},
        "ladder_after": after,
        "inflation_ladder": {},
        "inflation_ladder_after": {},
        "collateral": {
            "now": {"eligible": 1.1e8, "pv01": 0.0, "headroom": None, "required": 350},
            "after": {"eligible": 1.4e8, "pv01": 1.2e5, "headroom": 1166.0, "required": 350},
        },
        "stresses": [
            {"scenario": "Rates +100 bp", "assets": 240e6, "liability": 210e6, "funding": 1.14}
        ],
        "objective": {
            "terms": [],
            "value": -0.18,
            "equivalent": 1.09,
            "equivalent_error": 0.002,
            "aversion": 5.0,
        },
        "sensitivities": {
            "unit": "ratio",
            "families": [family, equity],
            "combined": [family | life],
            "rows": rows,
        },
        "outputs": outputs(),
        "policies": policies,
        "attribution": {
            "start": 1.048,
            "rows": [
                {"part": "rates", "name": "Rates", "assets": 0.05, "liability": -0.03}
                | {"mean": 0.02, "deviation": 0.1},
                {"part": "costs", "name": "Costs", "assets": -0.01, "liability": 0.0}
                | {"mean": -0.01, "deviation": 0.001},
            ],
            "change": {"mean": 0.01, "deviation": 0.12},
        },
        "frontier": {
            "level": 0.95,
            "points": [point, point | {"share": 1.0, "contributions": 3e7, "cvar": -0.3}],
            "learned": {key: point[key] for key in point if key not in ("share", "efficient")},
        },
        "variance": [
            {"source": "All sources", "mean": 1.15, "deviation": 0.25},
            {"source": "Without asset prices", "mean": 1.14, "deviation": 0.1, "explained": 0.84},
        ],
        "certificate": {
            "bump_check": [
                {
                    "family": "zero_rate",
                    "inputs": "random direction",
                    "worst_error": 1e-9,
                    "allowed": 1e-7,
                    "passed": True,
                }
            ],
            "feasibility": [
                {"limit": "bounds", "worst": 0.0, "path": 3, "step": 7, "passed": True}
            ],
            "smoothing_gap": 1e-4,
            "policy_gradient_norm": 1e-3,
        },
        "seconds": {"train": 20.0, "total": 31.0},
        "versions": {"snapo": "0.1.0"},
        "seed": 0,
        "engine": {"name": "native", "reason": "every operation is supported"},
        "paths": {"train": 512, "evaluate": 16384},
    }


HISTORY = (
    "step,objective,gradient_norm,temperature,bad_paths,exact,best,seconds\n"
    "1,-0.21,0.3,0.02,0,-0.2,-0.2,1\n50,-0.19,0.1,0.01,0,-0.185,-0.185,9\n"
)


@pytest.fixture
def drawn(tmp_path):
    """A run folder with everything in it, whose charts are drawn."""
    (tmp_path / "result.json").write_text(json.dumps(RESULT))
    (tmp_path / "history.csv").write_text(HISTORY)
    (tmp_path / "parts").mkdir()
    keep(tmp_path, sample())
    return tmp_path


@pytest.fixture
def folder(drawn, sketched):
    """The same folder; its charts are sketched."""
    return drawn


def keep(folder, details: dict) -> None:
    (folder / "parts" / "all.json").write_text(json.dumps(plain_json(details)))


def write_report(folder):
    return carry_out.write_report(DOMAIN, folder)


def written(folder, details: dict) -> str:
    keep(folder, details)
    return write_report(folder).read_text(encoding="utf-8")


class Balanced(HTMLParser):
    """Fails where tags are not closed in order."""

    EMPTY = frozenset({"meta", "link", "br", "input"})

    def __init__(self):
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        pass


def test_reconciliation_comes_first(folder):
    html = write_report(folder).read_text(encoding="utf-8")
    headings = re.findall(r'<section id="([^"]+)"', html)
    assert headings[:2] == ["headline", "reconciliation"]
    # Personal pots are told where there are some.
    assert len(headings) == len(set(headings)) == len(SECTIONS) - 1


def test_the_first_box_has_the_leads_over_other_policies(folder):
    html = write_report(folder).read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    head = html[html.index('id="headline"') : html.index('id="reconciliation"')]
    assert "+10.0 ± 2.0 bp a year over the best tuned classical rule (glide path)." in head
    present = ["present_mix", "Present mix", -0.2, 1.05, 0.005]
    details = sample()
    keys = ("key", "name", "value", "equivalent", "lead")
    details["policies"].append(details["policies"][1] | dict(zip(keys, present)))
    head = written(folder, details).replace("\N{NO-BREAK SPACE}", " ")
    assert "+50.0 ± 2.0 bp a year over the present mix; +10.0 ± 2.0 bp a year over" in head


def test_the_turnover_has_its_cost_and_its_limit(folder):
    html = write_report(folder).read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    cost = sum(x["cost"] for x in sample()["trades"]["classes"])
    assert f"Cost: EUR k {cost / 1e3:.2f}; no turnover limit is set in this case." in html
    limited = written(folder, sample() | {"turnover_limit": 0.25})
    assert "the limit is 25.0\N{NO-BREAK SPACE}% a year." in limited


def test_the_bar_has_at_most_seven_links(folder):
    html = write_report(folder).read_text(encoding="utf-8")
    links = re.findall(r"<a href=", html.split("<nav")[1].split("</nav>")[0])
    assert len(links) == 6  # and the inputs of a run of `snapo solve`


def test_a_weight_that_never_leaves_its_bound_is_a_sentence_on_its_class():
    assets = SimpleNamespace(
        classes=[SimpleNamespace(name=name) for name in CLASSES],
        low=np.zeros(6), high=np.array([0.3, 0.7, 0.6, 0.3, 0.6, 0.2]),
    )  # fmt: skip
    case = SimpleNamespace(assets=assets)
    advice = ": if that is not intended, try starts=4."
    one = f"Decision 1 of 8 never changes (0.0005499, at its limit){advice}"
    assert in_classes(one, case) == "Cash stays at its lower bound of 0\xa0%."
    two = f"2 of 8 decisions never change: 1 (0, at its limit), 4 (0.3, at its limit){advice}"
    assert in_classes(two, case) == (
        "Cash stays at its lower bound of 0\xa0%. Credit BBB stays at its upper bound of 30\xa0%."
    )
    for other in (one.replace("Decision 1", "Decision 7"), "A note.", one.replace(", at its", " ")):
        assert in_classes(other, case) == other  # a swap's place; another note; within its range


def test_the_page_is_whole_and_needs_nothing(drawn):
    html = write_report(drawn).read_text(encoding="utf-8")
    parser = Balanced()
    parser.feed(html)
    assert not parser.open
    assert 'class="missing"' not in html
    for word in ("nan", "None", "inf "):
        assert f">{word}<" not in html
    assert not re.search(r'(src|href)="https?:', html)
    names = re.findall(r' id="([^"]+)"', html)
    assert len(names) == len(set(names))


@pytest.mark.prove
def test_the_same_files_give_the_same_page(drawn):
    first = write_report(drawn).read_bytes()
    assert write_report(drawn).read_bytes() == first


def test_numbers_carry_their_units_and_their_measure(folder):
    html = write_report(folder).read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    for text in ("109.0 %", "EUR m 250.0", "250.00", "bp of the certainty equivalent"):
        assert text in html
    for title in ("Funding ratio by year (P)", "Sensitivities of the objective (P)"):
        assert title in html
    assert "Parallel = sum" in html


@pytest.mark.prove
@pytest.mark.parametrize("key", sorted(sample()))
def test_what_is_missing_is_said_in_a_sentence(folder, key):
    details = sample()
    del details[key]
    parser = Balanced()
    parser.feed(written(folder, details))
    assert not parser.open


def test_an_empty_folder_has_a_report(tmp_path):
    html = write_report(tmp_path).read_text(encoding="utf-8")
    assert html.count('class="missing"') > 8


@pytest.mark.prove
def test_a_failed_check_is_seen_at_once(folder):
    details = deepcopy(sample())
    details["reconciliation"]["lines"][0]["ok"] = False
    html = written(folder, details)
    head = html[html.index('id="headline"') : html.index('id="reconciliation"')]
    assert "fail: liability" in head


def test_other_objectives_are_shown_in_their_own_unit(folder):
    details = deepcopy(sample())
    del details["objective"]["equivalent"]
    details["sensitivities"]["unit"] = "objective"
    for each in details["policies"]:
        del each["equivalent"]
    html = written(folder, details)
    assert "Value of the objective (P)" in html
    assert "bp of the certainty equivalent" not in html


@pytest.mark.prove
def test_text_of_the_case_is_escaped(folder):
    details = sample() | {"title": "<script>alert(1)</script>"}
    assert "<script>alert" not in written(folder, details)


def test_the_parts_of_the_change_stand_above_their_sum(folder):
    html = write_report(folder).read_text(encoding="utf-8")
    part = html[html.index('id="attribution"') : html.index('id="variance"')]
    for text in ("All parts", "Change of F", "+1.00", "+5.00"):
        assert text in part


@pytest.mark.prove
def test_a_node_stands_in_the_bucket_of_its_name(folder):
    html = write_report(folder).read_text(encoding="utf-8")
    part = html[html.index('id="ladder"') : html.index('id="collateral"')]
    rows = re.findall(r"<t[hd][^>]*>(to 3y|\d+y|from 50y)</t[hd]>", part)
    assert rows == ["to 3y", "5y", "10y", "20y", "30y", "from 50y"]


@pytest.mark.prove
def test_a_year_of_life_is_told_and_defined(folder):
    html = write_report(folder).read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
    assert html.count("Year of life") >= 3  # picture, table and definition
    assert "until its life expectancy at 65 is a year longer" in html


@pytest.mark.prove
def test_a_shock_is_written_with_true_signs():
    names = ("Rates -100 bp and equity -30 %", "Spreads x 2", "Break-evens +50 bp", "1y-2y")
    assert [_signed(each) for each in names] == [
        "Rates −100 bp and equity −30 %", "Spreads × 2", "Break-evens +50 bp", "1y-2y"
    ]  # fmt: skip


def test_a_fund_without_swaps(folder):
    details: dict[str, Any] = sample() | {"collateral": {"now": None, "after": None}}
    del details["limits"]["collateral"]
    details["trades"]["swaps"] = []
    assert "needs no collateral" in written(folder, details)


def test_the_page_reads_its_run(folder):
    run = PensionRun.read(folder)
    assert run.horizon == "after 10 years"
    assert run.size(2.5e8, None)[0] == 1e6
    assert "A small pension fund" in write_report(folder).read_text(encoding="utf-8")


def test_a_parallel_shift_keeps_its_digits_where_the_objective_is_no_money():
    row = {"input": "zero_rate", "move": "1 bp", "reacting": 2e-4}
    node = NumberEffect(**row, label="1y", effect=0.001, low=0.00096, high=0.00104)
    whole = InputEffect(**row, effect=0.001309, low=0.001305, high=0.001313)
    table = sensitivities._nodes(whole, [node], 1.0, "objective")
    assert table.rows[-1][:3] == ("Parallel = sum", "1 bp", "+0.0013090")


def test_outputs_are_told_in_points_basis_points_and_money(folder):
    blocks = OUTPUTS(PensionRun.read(folder)).blocks
    summary, funding, paid = (each.rows for each in blocks if isinstance(each, Table))
    assert summary[0][1:] == ("+1.23", "−500")
    # Of a liability of 250 million.
    assert funding[0][1:] == ("+1.230", "±\xa00.039", "+123.0", "EUR\xa0m\xa0+3.08")
    assert paid[0][1:] == ("−0.200", "±\xa00.008", "−20.0", "EUR\xa0k\xa0−500.00")


@pytest.mark.prove
def test_inflation_and_the_regulator_are_told_where_they_are_there(folder):
    html = write_report(folder).read_text(encoding="utf-8")
    assert "inflation hedge ratios" not in html
    assert "Required funding ratio" not in html
    details = deepcopy(sample())
    prices = details["ladder"] | {"liability": -np.asarray(details["ladder"]["liability"])}
    details |= {"inflation_ladder": prices, "inflation_ladder_after": prices}
    losses = dict.fromkeys(("rates", "equity", "currencies", "commodities", "credit"), 1e7)
    losses |= {"insurance": 5e6, "active": 0.0, "falling": True}
    details["reconciliation"]["regulation"] = {
        "losses": losses, "required": 3.2e7, "minimum": 1e7, "required_ratio": 1.128,
        "minimum_ratio": 1.04, "policy_ratio": 1.048, "since": "2015-01-01", "source": "the law",
    }  # fmt: skip
    share = {"share": [0.1, 0.4], "median": [1.05, 1.11], "allowed": 10.0}
    details["recovery"] = {"years": [0, 1]} | share
    html = written(folder, details)
    ladder = html[html.index('id="ladder"') : html.index('id="collateral"')]
    assert "inflation hedge ratios" in ladder
    assert "Real rates" in ladder
    stand = html[html.index('id="reconciliation"') : html.index('id="ladder"')]
    for text in ("112.8", "in deficit: a recovery plan is needed", "falling rates", "40.0"):
        assert text in stand


def effects_on(html: str) -> str:
    """The table of the effects on the mean funding ratio, the first of all outputs."""
    return html.split("Mean funding ratio: every input")[1].partition(": every input")[0]


@pytest.mark.prove
def test_personal_pots_take_the_place_of_parts_that_are_of_rights(drawn):
    cohort = {"name": "Pensioners", "pot": 1.02e8, "earned": 11800.0, "pension": 11817.0}
    cohort |= {"horizon": [11655.0, 12117.0, 12659.0], "of_salary": None, "volatility": 0.0153}
    pots = {
        "cohorts": [cohort | {"cut": 0.137, "fall": 0.0118}],
        "years": [0.0, 1.0],
        "reserve": [[0.05, 0.05, 0.05], [0.039, 0.0497, 0.058]],
        "quantiles": [0.05, 0.5, 0.95],
        "level": 1.0015, "filled": 3.7e6, "released": 2.6e6,
        "since": "2023-07-01", "source": "the law",
    }  # fmt: skip
    details = deepcopy(sample()) | {"personal": True, "pots": pots}
    details["objective"] |= {"output": "pension"}
    html = written(drawn, details)
    headings = re.findall(r'<section id="([^"]+)"', html)
    assert not {"funding", "attribution", "variance", "frontier"} & set(headings)
    assert "Certainty-equivalent pension" in html and "P(F &lt; 1)" not in html
    first = html[: html.index('id="reconciliation"')]
    assert "Years with a cut" in first and "13.7" in first and "Underfunded" not in first
    assert "In money" not in effects_on(html)
    assert "points of today" in html and "share of today's liability" not in html
    told = html[html.index('id="pots"') :]
    for text in ("Pensioners", "100.1", "12,117", "13.7", "Rules from 2023-07-01: the law."):
        assert text in told.replace("\u2009", ",").replace("\u202f", ",")


@pytest.mark.prove
def test_increases_without_a_choice_are_told_in_a_sentence(folder):
    """Fixed ones, and none at all: nothing is missing."""
    details, years = deepcopy(sample()), np.arange(1, YEARS + 1)
    for rate, words in ((0.02, "Pensions rise by 2.00 % every year"), (0.0, "grants no increases")):
        details["by_year"]["indexation"] = fan(0 * years + rate, 0.0)
        details["by_year"]["cumulated"] = fan((1 + rate) ** years, 0.0)
        html = written(folder, details).replace("\N{NO-BREAK SPACE}", " ")
        assert words in html and 'class="missing"' not in html


def test_borrowed_cash_hangs_below_zero(folder):
    """Of the mix: bonds reach 140 %, cash -40 %, and the axis shows both."""
    details = deepcopy(sample())
    mix = np.array([-0.4, 1.2, 0.1, 0.05, 0.03, 0.02])
    details["mix"]["weights"] = np.repeat(mix[:, None], YEARS, 1)
    html = written(folder, details)
    assert "A weight below zero is a short position" in html and 'class="missing"' not in html
    assert f"Cash {number(-40, 0)} % now" in html


def test_layers_are_stacked_away_from_zero_on_either_side():
    axes = Figure().subplots()
    values = [np.array([1.2, 0.9]), np.array([-0.4, 0.1]), np.array([0.2, 0.0])]
    stack(axes, np.arange(2.0), [Layer(str(i), v, "main") for i, v in enumerate(values)], "%")
    corners = [np.asarray(each.get_paths()[0].vertices) for each in axes.collections]
    ends = [(c[:, 1].min(), c[:, 1].max()) for c in corners]
    # The second layer is on either side in turn: above 0.9 by 0.1, below 0 by 0.4.
    assert ends == [(0, 1.2), (0.9, 1.2), (-0.4, 0), (1.0, 1.4)]
