"""The files of a pharma run as its report reads them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.report.folder import Folder
from snapo.report.quantity import quantity, unit_words


@dataclass(frozen=True)
class Run(Folder):
    """A run folder; tables are [Q, P] lists in the order of attributes and parameters."""

    @property
    def attributes(self) -> list[dict[str, Any]]:
        return [_written(each) for each in self.get("attributes", [])]

    @property
    def parameters(self) -> list[dict[str, Any]]:
        return [_written(each) for each in self.get("parameters", [])]

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """Names of the attributes and of the parameters."""
        return [a["name"] for a in self.attributes], [p["name"] for p in self.parameters]

    def table(self, path: str) -> np.ndarray | None:
        """A table of numbers of a part as float64; its nulls are NaN."""
        found = self.get(path)
        if not found:
            return None
        array = np.array(found, dtype=object)
        return np.where(array == None, np.nan, array).astype(np.float64)  # noqa: E711


def _written(each: dict[str, Any]) -> dict[str, Any]:
    """An attribute or a parameter with its unit as it is written by hand."""
    return {**each, "unit": unit_words(str(each["unit"]))} if "unit" in each else each


def limits(attribute: dict[str, Any]) -> str:
    """ "70 to 100 um", "at most 720 ppm"."""
    low, high, unit = attribute.get("low"), attribute.get("high"), attribute.get("unit", "")
    unit = "" if unit == "1" else unit
    if low is not None and high is not None:
        return f"{quantity(low, '')} to {quantity(high, unit)}"
    if low is not None:
        return f"at least {quantity(low, unit)}"
    return f"at most {quantity(high, unit)}" if high is not None else "no limit"
