"""Objective, training and evaluation of an inventory case, of one item or of a network; the season
of a demand; ranges outside which a number is likely to be in another unit.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.plausible import CaseFiles, CheckedNumbers, Plausible, checked_numbers, implausible
from snapo.case.quantity import Quantity, Range
from snapo.case.settings import check_window, read_evaluation, read_objective, read_training
from snapo.case.table import TableContext, parse

from ..demand.base import DEVIATION, MEAN
from .tables import SeasonTable


class FileWithSettings(Protocol):
    """A file with these tables."""

    objective: dict
    training: dict
    evaluation: dict


def read_settings(top: FileWithSettings, file: str) -> dict[str, Any]:
    """Objective, training and evaluation, in the form of a case.

    **Raises:** `CaseError` for every mistake, and for an objective that does not apply to costs.
    """
    settings = {
        "objective": read_objective(top.objective, file),
        "training": read_training(top.training, file),
        "evaluation": read_evaluation(top.evaluation, file),
    }
    kind = settings["objective"].kind
    check_window(settings["training"], [kind], file)
    if kind == "crra":
        message = (
            'kind "crra" is for wealth, not for costs; use mean, cvar, mean-variance, entropic or '
            "target"
        )
        raise CaseError(file, "objective.kind", "crra", message)
    return settings


SHORTEST_SEASON, LONGEST_SEASON = 2, 366  # periods
FACTOR = Quantity(
    "1", Range(0.001, 1000.0), "demand", column="factor",
    plausible=Plausible(0.02, 20.0, "the factor multiplies the mean; 1.2 is 120 %"),
    meaning="demand of a period relative to the mean",
)  # fmt: skip


def read_season(section: TableContext, data: Mapping[str, Any]) -> CaseInput:
    """The factors of demand by position in the season, from the table `section`.

    **Raises:** `CaseError` for a table, a file or a number that is wrong.
    """
    table = parse(SeasonTable, data, str(section.file), section.name)
    rows = read_rows(FileReference(section, "file", table.file), ["period", "factor"], [])
    if not SHORTEST_SEASON <= len(rows) <= LONGEST_SEASON:
        message = (
            f"there are {len(rows)} periods; {SHORTEST_SEASON} to {LONGEST_SEASON} are allowed"
        )
        raise CaseError(table.file, "", None, message)
    return FACTOR.from_rows("season", rows, [row.label("period") for row in rows])


def no_season() -> CaseInput:
    """The factor 1 in all periods."""
    return CaseInput("season", np.ones(1), ("all",), "1", np.zeros(1, int), meaning=FACTOR.meaning)


def unit_slips(files: CaseFiles, inputs: Iterable[Any], period: str) -> list[str]:
    """Notes on implausible numbers of an item or a network."""
    entries = [checked_numbers(entry) for entry in inputs]
    return list(implausible(entries, list(_ranges(entries, period)), files).values())


def _ranges(entries: Sequence[CheckedNumbers], period: str) -> Iterator[Plausible]:
    """The ranges, some of which depend on the size of other numbers of the case."""
    by_period = f"it must refer to one {period}"
    hint = f"a factor per {period} is expected, such as 0.999, and not a rate such as 0.001"
    yield Plausible(0.5, 1.0, hint, names=("discount",))
    cost = {entry.name: entry.values[entry.values > 0] for entry in entries}
    short, bought = (cost.get(name, np.zeros(0)) for name in ("shortage_cost", "purchase_cost"))
    if short.size:
        hint = f"{by_period} and unit, and a missing unit costs {short.max():.6g}"
        yield Plausible(short.max() / 1e5, 10 * short.max(), hint, names=("holding_cost",))
    if bought.size:
        hint = f"a unit costs {bought.max():.6g}"
        yield Plausible(bought.max() / 1e3, 1e3 * bought.max(), hint, names=("shortage_cost",))
    mean = max(
        (float(entry.values.max()) for entry in entries if entry.name.endswith(MEAN)), default=0.0
    )
    if mean > 0:
        hint = f"{by_period}, and the mean demand is {mean:.6g}"
        yield Plausible(0.0, 5 * mean, hint, endings=(DEVIATION,))
        hint = f"the mean demand of a {period} is {mean:.6g}"
        yield Plausible(0.0, 1000 * mean, hint, names=("start_stock", "start_coming"))
