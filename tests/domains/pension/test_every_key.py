"""Every documented key, word and column of a pension case, in cases that are read.

The list is made from the format's own description: the tables with their keys and words, the
columns that their descriptions name, and the registries of kinds.
"""

import csv
import re
from typing import Any, Literal, get_args, get_origin

import numpy as np
import pytest
from tests.domains.pension.every_key import CASES, FILES, scenarios, written

from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.domains.pension.market.registry import KINDS, MODELS
from snapo.domains.pension.read import tables, tables_people
from snapo.domains.pension.read.assets import OPTIONAL
from snapo.domains.pension.read.case import resolve
from snapo.domains.pension.records.inputs import every_given, pension_inputs

TABLES = {
    "fund": tables.FundTable,
    "curve": tables.CurveTable,
    "rates": tables.RatesTable,
    "inflation": tables.InflationTable,
    "assets": tables.AssetsTable,
    "credit": tables.CreditTable,
    "currencies": tables.CurrenciesTable,
    "correlations": tables.CorrelationsTable,
    "overlay": tables.OverlayTable,
    "members": tables_people.MembersTable,
    "mortality": tables_people.MortalityTable,
    "lee_carter": tables_people.LeeCarterTable,
    "plan": tables_people.PlanTable,
    "plan.indexation": tables_people.IndexationTable,
    "plan.revaluation": tables_people.RevaluationTable,
    "plan.contribution": tables_people.ContributionTable,
    "liability": tables_people.LiabilityTable,
    "reconcile": tables_people.ReconcileTable,
    "scenarios": tables.ScenariosTable,
    "policy": tables.PolicyTable,
    "objective": ObjectiveTable,
    "sensitivity": tables.SensitivityTable,
    "regulation": tables.RegulationTable,
    "funding": tables.FundingTable,
    "pots": tables.PotsTable,
    "stress": tables.StressTable,
    "frontier": tables.FrontierTable,
    "report": tables.FundReportTable,
    "training": TrainingTable,
    "evaluation": EvaluationTable,
}
# Words that a table leaves to a registry, and keys that a reader takes before its table.
REGISTRIES = {("rates", "kind"): set(MODELS)}
BESIDE = {("objective", "weight"), ("objective", "output")}
PROSE = {"and", "or", "where", "they", "apply", "others"}


def words(annotation: Any) -> set[str]:
    """The words that a key may have."""
    if get_origin(annotation) is Literal:
        return {each for each in get_args(annotation) if isinstance(each, str)}
    return set().union(*(words(each) for each in get_args(annotation)))


def documented() -> tuple[set, set, set]:
    """(table, key), (table, key, word) and (table, key, column) of the whole format."""
    keys, chosen, columns = set(BESIDE), set(), set()
    for name, table in TABLES.items():
        for key, field in table.model_fields.items():
            keys.add((name, key))
            known = REGISTRIES.get((name, key)) or words(field.annotation)
            chosen |= {(name, key, word) for word in known}
            text = (field.description or "").partition("columns ")[2].partition(";")[0]
            columns |= {(name, key, c) for c in re.findall(r"[a-z_]+", text) if c not in PROSE}
    columns |= {("assets", "file", column) for column in OPTIONAL}
    return keys, chosen, columns


def used() -> tuple[set, set, set]:
    """The same of the cases."""
    keys, chosen, columns = set(), set(), set()
    for data in CASES.values():
        for name, table in every_table(data):
            for key, value in table.items():
                keys.add((name, key))
                for each in value if isinstance(value, list) else [value]:
                    if isinstance(each, str):
                        chosen.add((name, key, each))
                    if isinstance(each, str) and each in FILES:
                        columns |= {(name, key, column) for column in header(each)}
    return keys, chosen, columns


def every_table(data):
    """(name, table) of a case: tables below others, and arrays of them, too."""
    for name, value in data.items():
        for table in value if isinstance(value, list) else [value]:
            if isinstance(table, dict):
                yield name, table
                yield from ((f"{name}.{k}", v) for k, v in table.items() if isinstance(v, dict))


def header(file: str) -> list[str]:
    return next(csv.reader([FILES[file].lstrip().splitlines()[0]]))


def test_the_cases_use_all_that_is_documented():
    top = {key for key, field in tables.PensionTable.model_fields.items() if key not in TABLES}
    assert top == {"kind", "title"}
    for name, want, have in zip(("keys", "words", "columns"), documented(), used()):
        assert sorted(want - have) == [], f"{name} that no case uses"
    classes = [line.split(",") for line in FILES["assets.csv"].strip().splitlines()]
    assert {cells[1] for cells in classes[1:]} == set(KINDS)
    columns = dict(zip(classes[0], zip(*classes[1:], strict=True)))
    for name, kind in KINDS.items():
        rows = [i for i, each in enumerate(columns["kind"]) if each == name]
        for special in kind.columns:
            if special != "smoothing" or name != "equity":
                assert any(columns[special][i] for i in rows), f"{special} of kind {name}"
    assert scenarios(1, 2).count("\n") == 5


# Its Smith-Wilson curve is compiled.
SLOW = ("cash flows",)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.prove] * (n in SLOW)) for n in CASES]
)
def test_a_case_is_read(name, tmp_path):
    """Every number of it is an input, or held by name."""
    data = {key: value for key, value in CASES[name].items() if value is not None}
    case = resolve(written(tmp_path), data)
    inputs = pension_inputs(case)
    assert {given.name for given in every_given(case)} == set(inputs) | set(case.held)
    assert all(np.isfinite(each.value).all() for each in inputs.values())
