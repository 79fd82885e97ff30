"""The season of a demand: a factor for each period, repeated cyclically."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from snapo.case.csv import FileReference, read_rows
from snapo.case.error import CaseError
from snapo.case.given import CaseInput
from snapo.case.plausible import Plausible
from snapo.case.quantity import Quantity, Range
from snapo.case.table import TableContext, parse

from .tables import SeasonTable

SHORTEST_SEASON, LONGEST_SEASON = 2, 366  # periods
FACTOR = Quantity(
    "1", Range(0.001, 1000.0), "demand", column="factor",
    plausible=Plausible(0.02, 20.0, "it is a factor of the mean, 1.2 is 120 %"),
    meaning="demand of a period, relative to the mean",
)  # fmt: skip


def read_season(section: TableContext, data: Mapping[str, Any]) -> CaseInput:
    """Factors of demand by place in the season, of the table `section`.

    **Raises:** `CaseError` for a table, a file or a number that is wrong.
    """
    table = parse(SeasonTable, data, str(section.file), section.name)
    rows = read_rows(FileReference(section, "file", table.file), ["period", "factor"], [])
    if not SHORTEST_SEASON <= len(rows) <= LONGEST_SEASON:
        message = (
            f"there are {len(rows)} periods; allowed are {SHORTEST_SEASON} to {LONGEST_SEASON}"
        )
        raise CaseError(table.file, "", None, message)
    return FACTOR.from_rows("season", rows, [row.label("period") for row in rows])


def no_season() -> CaseInput:
    """The factor 1 in all periods."""
    return CaseInput("season", np.ones(1), ("all",), "1", np.zeros(1, int), meaning=FACTOR.meaning)
