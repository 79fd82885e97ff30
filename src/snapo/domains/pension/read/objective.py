"""Reads `[objective]`: one aim of the policy, or several that are added up."""

from collections.abc import Mapping, Sequence
from typing import Any

from snapo.case.error import CaseError
from snapo.case.settings import read_objective, read_weight
from snapo.case.table import nearest

from ..fund.simulator import OUTPUTS
from ..records.case import ObjectiveTerm

# The output of each kind of objective, where the case does not name one.
USUAL = {"cvar": "surplus_ratio", "mean": "funding_ratio"}


def read_objectives(file: str, data: Any, more: Sequence[str] = ()) -> tuple[ObjectiveTerm, ...]:
    """One table, or several that are added up; `more`: further outputs than those of every fund."""
    many = isinstance(data, list)
    terms = data if many else [data or {"kind": "crra", "risk_aversion": 5.0}]
    if not terms:
        raise CaseError(file, "objective", data, "at least one table is needed")
    return tuple(
        _term(file, f"objective.{i}" if many else "objective", term, (*OUTPUTS, *more))
        for i, term in enumerate(terms, 1)
    )


def _term(file: str, name: str, data: Any, available: Sequence[str]) -> ObjectiveTerm:
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, "this must be a table")
    rest = {key: value for key, value in data.items() if key not in ("weight", "output")}
    table = read_objective(rest, file, name, optional=("wealth",))
    weight = read_weight(data, table, file, name)
    output = data.get("output", USUAL.get(table.kind, "funding_ratio"))
    if output not in available:
        close = nearest(str(output), available)
        raise CaseError(file, f"{name}.output", output, f"there is no such output; {close}")
    return ObjectiveTerm(weight, str(output), table)
