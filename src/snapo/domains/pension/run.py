"""The files of a pension run as its report reads them, with money in thousands, millions or
billions."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.case.error import counted
from snapo.report.folder import RunFiles
from snapo.report.quantity import NONE, SPACE, decimals, finite, money, number, percent

from .records.case import OF_RIGHTS

OF_POTS = ("pots",)  # the parts that a fund of promised rights has not
SIZES = ((1e9, "bn"), (1e6, "m"), (1e3, "k"))


@dataclass(frozen=True)
class PensionRun(RunFiles):
    """A run folder with the units of the fund."""

    @property
    def measure(self) -> str:
        """The label of every number of the scenarios: "P", "Q" or "supplied"."""
        return str(self.get("measure", "P"))

    @property
    def personal(self) -> bool:
        """Whether it is a fund of personal pots."""
        return bool(self.get("personal"))

    @property
    def assets(self) -> float:
        """Market value today."""
        return float(self.get("assets", np.nan))

    @property
    def model(self) -> str:
        """The model of the scenarios in a sentence."""
        return str(self.get("model", ""))

    @property
    def kinds(self) -> dict[str, str]:
        """{kind of asset: its meaning}."""
        return self.get("kinds", {})

    @property
    def held(self) -> list[str]:
        """Names of inputs that are held fixed."""
        return self.get("held", [])

    def left_out(self, *parts: str) -> bool:
        """Whether the run left out all of these parts that this kind of fund can have."""
        others = OF_RIGHTS if self.personal else OF_POTS
        return super().left_out(*(part for part in parts if part not in others))

    @property
    def horizon(self) -> str:
        """The horizon as text, "after 10 years"."""
        return f"after {counted(self.years or 0, 'year')}"

    @property
    def years(self) -> float | None:
        return self.get("years")

    @property
    def step(self) -> float:
        """The length of a step in years."""
        return float(self.get("step") or 1.0)

    def size(self, *values: Any) -> tuple[float, str]:
        """The divisor of money (a thousand, a million or a billion) that suits the largest of
        `values`, and the unit."""
        sizes = [abs(v) for value in values for v in _each(value)]
        largest = max(sizes, default=0.0)
        scale, letters = next((pair for pair in SIZES if largest >= pair[0]), (1.0, ""))
        return scale, f"{self.currency}{SPACE}{letters}".strip()

    def large(self, value: Any, digits: int | None = None, sign: bool = False) -> str:
        """An amount of money as text with at least three digits: "EUR m 26.2"."""
        available = finite(value)
        if available is None:
            return NONE
        scale, unit = self.size(available)
        digits = max(1, decimals([available / scale], 3)) if digits is None else digits
        return money(available / scale, unit, digits, sign)


def _each(value: Any) -> list[float]:
    values = np.ravel(np.asarray(value, np.float64)) if value is not None else np.zeros(0)
    return [float(v) for v in values if np.isfinite(v)]


def with_measure(title: str) -> Callable[[PensionRun], str]:
    """The title of a section with the label of its scenarios: "Efficient frontier (P)"."""
    return lambda run: f"{title} ({run.measure})"


def points(value: Any, digits: int = 2, sign: bool = False) -> str:
    """A share as percentage points: 0.0123 as "1.23"."""
    available = finite(value)
    return NONE if available is None else number(100 * available, digits, sign)


def share(value: Any, digits: int = 1) -> str:
    """A share in per cent."""
    return percent(value, digits)


def name_of(name: str, label: str = "") -> str:
    """An input as text: "Zero rate, 10y"."""
    text = name.replace("plan_", "").replace("_", " ").replace("lee carter", "Lee-Carter")
    text = text[:1].upper() + text[1:]
    return f"{text}, {label}" if label else text
