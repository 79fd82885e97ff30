"""The files of a pension run as its report reads them, with money in the size that reads best."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.report.folder import Folder
from snapo.report.quantity import NONE, SPACE, decimals, finite, money, number, percent

SIZES = ((1e9, "bn"), (1e6, "m"), (1e3, "k"))


@dataclass(frozen=True)
class PensionRun(Folder):
    """A run folder with the units of the fund."""

    @property
    def measure(self) -> str:
        """The label that every number of the scenarios carries: "P", "Q" or "supplied"."""
        return str(self.get("measure", "P"))

    @property
    def horizon(self) -> str:
        """The horizon in words, "after 10 years"."""
        return f"after {number(self.get('years'), 0)} years"

    def size(self, *values: Any) -> tuple[float, str]:
        """The divisor of money with which the largest of `values` reads well, and the unit."""
        sizes = [abs(v) for each in values for v in _each(each)]
        largest = max(sizes, default=0.0)
        scale, letters = next((pair for pair in SIZES if largest >= pair[0]), (1.0, ""))
        return scale, f"{self.currency}{SPACE}{letters}".strip()

    def large(self, value: Any, places: int | None = None, sign: bool = False) -> str:
        """An amount of money in millions or billions, three digits at least: "EUR m 26.2"."""
        known = finite(value)
        if known is None:
            return NONE
        scale, unit = self.size(known)
        places = max(1, decimals([known / scale], 3)) if places is None else places
        return money(known / scale, unit, places, sign)


def _each(value: Any) -> list[float]:
    values = np.ravel(np.asarray(value, np.float64)) if value is not None else np.zeros(0)
    return [float(v) for v in values if np.isfinite(v)]


def points(value: Any, places: int = 2, sign: bool = False) -> str:
    """A share as percentage points: 0.0123 as "1.23"."""
    known = finite(value)
    return NONE if known is None else number(100 * known, places, sign)


def share(value: Any, places: int = 1) -> str:
    """A share in per cent."""
    return percent(value, places)
