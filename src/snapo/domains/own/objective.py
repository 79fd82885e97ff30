"""Reads `[objective]`: one aim of the policy, or several `[[objective]]` that are added up."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from snapo.case.error import CaseError
from snapo.case.objective import make_objective
from snapo.case.settings import ObjectiveTable, read_objective, read_weight
from snapo.problem.objective import Objective, Weighted


class Aim(NamedTuple):
    """`weight` times one objective of one output; `key`: where it stands in the case."""

    key: str
    weight: float
    output: str
    table: ObjectiveTable

    @property
    def description(self) -> str:
        """The objective as a phrase."""
        name, table = self.output.replace("_", " "), self.table
        if table.kind == "cvar":
            return f"mean of the worst {100 * (1 - (table.level or 0.95)):.3g} % of {name}"
        return f"{table.kind.replace('-', ' ').replace('crra', 'expected utility')} of {name}"


def read_aims(data: Any, file: str) -> tuple[Aim, ...]:
    """One table, or several that are added up."""
    many = isinstance(data, list)
    if many and not data:
        raise CaseError(file, "objective", data, "at least one table is needed, [objective]")
    return tuple(
        _aim(item, f"objective.{i}" if many else "objective", file)
        for i, item in enumerate(data if many else [data], 1)
    )


def objective_of(aims: tuple[Aim, ...]) -> Objective:
    """The sum of the aims."""
    terms = [(aim.weight, make_objective(aim.table, aim.output)) for aim in aims]
    return terms[0][1] if len(terms) == 1 and terms[0][0] == 1 else Weighted(*terms)


def words_of(aims: tuple[Aim, ...]) -> str:
    """ "mean of cash + 0.5 x mean of the worst 10 % of cash"."""
    text = ""
    for aim in aims:
        sign = "" if not text and aim.weight > 0 else "- " if aim.weight < 0 else "+ "
        factor = "" if abs(aim.weight) == 1 else f"{abs(aim.weight):g} × "
        text += f"{' ' if text else ''}{sign}{factor}{aim.description}"
    return text


def unit_of(aims: tuple[Aim, ...], units: Mapping[str, str]) -> str:
    """The unit of the sum: that of its parts, where they all have the same."""
    result = {units.get(aim.output, "") if aim.table.keeps_unit else "" for aim in aims}
    return result.pop() if len(result) == 1 else ""


def _aim(data: Any, name: str, file: str) -> Aim:
    if not isinstance(data, Mapping):
        raise CaseError(file, name, data, "this must be a table, [objective]")
    output = data.get("output")
    if not isinstance(output, str) or not output:
        message = "it is the name of the simulator's output that is made as large as possible"
        message = f"this key is missing; {message}" if output is None else message
        raise CaseError(file, f"{name}.output", output, message)
    rest = {key: value for key, value in data.items() if key not in ("weight", "output")}
    table = read_objective(rest, file, name)
    return Aim(name, read_weight(data, table, file, name), output, table)
