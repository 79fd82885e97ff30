"""Every key in every mode of a case: accepted where it has a meaning, refused where it has none."""

import datetime
from pathlib import Path

import pytest
from tests.domains.pension.every_key import CASES, MARKET, written
from tests.domains.pension.test_every_key import every_table

from snapo.case.error import CaseError
from snapo.case.table import parse
from snapo.domains.pension import DOMAIN
from snapo.domains.pension.read.case import FORMATS, parsed, read_case
from snapo.domains.pension.read.tables import PensionTable

FILE = Path("case.toml")


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    """The CSVs that a key may name lie beside the case."""
    written(tmp_path)
    monkeypatch.chdir(tmp_path)


# Tables that a case may add without any other key of theirs.
OPTIONAL = ("plan", "plan.indexation", "plan.revaluation", "plan.contribution", "liability",
            "reconcile")  # fmt: skip
# What no case of cohorts and nothing else has a use for: the numbers of rules that it has not.
RULES = {
    *(f"plan.indexation.{key}" for key in ("rate", "month", "averaging", "cap", "floor",
      "lower_ratio", "upper_ratio", "required_ratio")),
    *(f"plan.contribution.{key}" for key in ("normal_cost", "rate", "loading", "spread_factor",
      "target_ratio", "recovery", "recovery_years", "floor", "cap", "sponsor_limit")),
    "curve.speed", "curve.convergence", "inflation.speed", "liability.rate", "reconcile.tolerance",
}  # fmt: skip
COHORTS = {
    *(f"plan.{key}" for key in ("age_basis", "fractional_ages", "retirement_age", "open", "entry_age",
      "max_service", "accrual_rate", "offset", "spouse_share", "married_share", "spouse_age_gap")),
    "plan.revaluation.deferred", "plan.revaluation.active",
}  # fmt: skip
NESTED = {"plan.entry_age", "plan.max_service", "plan.offset", "plan.married_share",
          "plan.spouse_age_gap"}  # fmt: skip
OF_FLOWS = {"members.normal_cost", "members.salary"}
FORMULA = {"mortality.male", "mortality.female"}
FUND = {"years": 2, "assets": 200.0, "valuation_date": datetime.date(2024, 12, 31)}
BASE = {key: value for key, value in MARKET.items() if key not in ("fund", "policy")} | {
    "fund": FUND
}
FLOWS = BASE | {"members": {"cash_flows": "flows.csv"}, "mortality": None}


def plan(**tables):
    return {"plan": tables}


# Name: (the case, the keys that it refuses).
MODES = {
    "cohorts": (BASE, RULES | NESTED | OF_FLOWS | FORMULA),
    "formula": (
        BASE | {"mortality": {"kind": "gompertz-makeham", "male": [-10.0, 0.1], "female": [-11.0, 0.1]}},
        RULES | NESTED | OF_FLOWS | {"mortality.file"},
    ),
    "accrual and spouses": (
        BASE | plan(accrual_rate=0.02, spouse_share=0.7, open=True),
        RULES | OF_FLOWS | FORMULA,
    ),
    "frozen": (
        BASE | plan(accruing=False, spouse_share=0.7, open=True),
        (RULES | OF_FLOWS | FORMULA | {"plan.entry_age", "plan.max_service", "plan.offset"}
         | {"plan.accrual_rate"}),
    ),
    "cash flows": (FLOWS, RULES | COHORTS | {"members.salary"}),
    "cash flows with contributions": (
        FLOWS | plan(contribution={"kind": "fixed", "rate": 0.1}),
        (RULES | COHORTS) - {f"plan.contribution.{key}" for key in
                             ("rate", "floor", "cap", "sponsor_limit")},
    ),
    "frozen cash flows": (
        FLOWS | plan(accruing=False), RULES | COHORTS | OF_FLOWS,
    ),
    "pots": (
        BASE | {"pots": CASES["personal pots"]["pots"]},
        ((RULES | NESTED | OF_FLOWS | FORMULA) - {"plan.indexation.month"})
        | {"plan.accruing", "plan.accrual_rate", "plan.indexation.cut_years",
           "plan.revaluation.deferred", "plan.revaluation.active", "liability.expense_loading",
           "plan.contribution.schedule"},
    ),
    "conditional increases": (
        BASE | plan(indexation={"kind": "conditional"}),
        ((RULES | NESTED | OF_FLOWS | FORMULA)
         - {f"plan.indexation.{key}" for key in
            ("month", "averaging", "cap", "floor", "lower_ratio", "upper_ratio")})
        | {"plan.revaluation.deferred", "plan.revaluation.active"},
    ),
    "increases with cuts": (
        BASE | plan(indexation={"kind": "full", "cut_years": 5}),
        ((RULES | NESTED | OF_FLOWS | FORMULA)
         - {f"plan.indexation.{key}" for key in ("month", "averaging", "required_ratio")})
        | {"plan.revaluation.deferred", "plan.revaluation.active"},
    ),
    "fixed increases": (
        BASE | plan(indexation={"kind": "fixed", "rate": 0.03}),
        (RULES | NESTED | OF_FLOWS | FORMULA) - {"plan.indexation.rate", "plan.indexation.month"},
    ),
    "contributions by cost": (
        BASE | plan(contribution={"kind": "spread", "spread_factor": 0.1}),
        (RULES | NESTED | OF_FLOWS | FORMULA)
        - {f"plan.contribution.{key}" for key in
           ("normal_cost", "loading", "spread_factor", "floor", "cap", "sponsor_limit")},
    ),
    "contributions by rate": (
        BASE | plan(contribution={"kind": "target", "normal_cost": "rate", "rate": 0.2}),
        (RULES | NESTED | OF_FLOWS | FORMULA)
        - {f"plan.contribution.{key}" for key in
           ("normal_cost", "rate", "target_ratio", "recovery", "recovery_years", "floor", "cap",
            "sponsor_limit")},
    ),
    "other bases": (
        BASE | {"liability": {"basis": "fixed", "rate": 0.03}, "reconcile": {"duration": 9.0}}
        | {"curve": {"file": "zero.csv", "extrapolation": "smith-wilson", "ultimate": 0.03}}
        | {"inflation": {"break_evens": "b.csv", "extrapolation": "ultimate", "ultimate": 0.02}},
        (RULES | NESTED | OF_FLOWS | FORMULA)
        - {"curve.speed", "curve.convergence", "inflation.speed", "liability.rate",
           "reconcile.tolerance"},
    ),
}  # fmt: skip


def samples():
    """(table, key): a value that some case has; see `test_every_key`."""
    found = {}
    for data in CASES.values():
        for name, table in every_table(data):
            if name in FORMATS:
                found |= {(name, key): value for key, value in table.items()
                          if not isinstance(value, dict)}  # fmt: skip
    return found


def with_key(data, name, key, value):
    """The case with one more key; None if it has that key, or not that table."""
    above, _, inner = name.rpartition(".")
    table = data.get(above or inner) or {}
    table = (table.get(inner) or {}) if above else table
    if key in table or (not table and name not in OPTIONAL):
        return None
    table = table | {key: value}
    return (
        data | {above: (data.get(above) or {}) | {inner: table}} if above else data | {inner: table}
    )


def refusal(data):
    """The places of what is refused, with the whole message."""
    given = {key: value for key, value in data.items() if value is not None}
    try:
        parsed(FILE, parse(PensionTable, given, str(FILE), ""))
    except CaseError as error:
        return [each.where for each in (error, *error.others)], str(error)
    return [], ""


@pytest.mark.parametrize("mode", MODES)
def test_every_key_is_refused_where_it_means_nothing_and_only_there(mode):
    data, expected = MODES[mode]
    assert refusal(data) == ([], "")
    found, tried = set(), 0
    for (name, key), value in samples().items():
        more = with_key(data, name, key, value)
        if more is None:
            continue
        tried += 1
        places, message = refusal(more)
        if places:
            where = f"{name}.{key}"
            assert len(places) == 1 and places[0] in (where, name), message
            assert f"case.toml, {places[0]}:" in message
            assert "is used only" in message, message
            found.add(where)
    assert tried > 60
    assert found == expected


@pytest.mark.parametrize(
    ("table", "case"),
    [(name, "pots") for name in ("regulation", "funding", "frontier", "lee_carter")]
    + [(name, "cash flows") for name in ("mortality", "lee_carter")],
)
def test_tables_without_a_meaning_are_refused(table, case):
    places, message = refusal(MODES[case][0] | {table: CASES["everything"][table]})
    assert places == [table]
    assert "does not use this key; it is used only for" in message


def test_all_mistakes_are_named_at_once():
    terms = {"spouse_share": 0.7, "married_share": 0.6, "indexation": {"cap": 0.05}}
    places, message = refusal(FLOWS | {"plan": terms})
    assert places == ["plan.spouse_share", "plan.married_share", "plan.indexation.cap"]
    assert len(message.splitlines()) == 3
    assert '0.05; "none" does not use this key; it is used only with kind "capped"' in message


@pytest.mark.parametrize("size", DOMAIN.templates)
def test_the_templates_state_nothing_without_a_meaning(size):
    assert read_case(Path(str(DOMAIN.templates[size]))).steps > 0
