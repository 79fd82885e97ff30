"""All that is said about the numbers of a key: unit, usual move, family of risk, meaning.

The usual moves of an actuary: rates, spreads and fees one basis point, shares, volatilities and
ratios one percentage point, quantities (money, members, death probabilities) one per cent of
themselves. Groups, which reports and readers ask for: "curve" (nodes of a curve), "volatility",
"premium" (counts in the real world only), "model", "assets", "overlay", "people", "plan".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from snapo.case.given import CaseInput

SQUARE_ROOT, YEARLY = "1/sqrt(year)", "1/year"


@dataclass(frozen=True)
class InputNumber:
    """Of a number: its unit, and the fields of `CaseInput` of the same names."""

    unit: str
    meaning: str
    group: str
    move: float | None
    display_unit: str = ""
    display_factor: float = 1.0

    def input(self, name: str, values: Any, labels: Sequence[str], index: np.ndarray) -> CaseInput:
        """Numbers with all that is said about them."""
        return CaseInput(
            name,
            np.asarray(values, np.float64),
            tuple(labels),
            self.unit,
            index,
            move=self.move,
            display_unit=self.display_unit,
            display_factor=self.display_factor,
            group=self.group,
            meaning=self.meaning,
        )


def rate(text: str, group: str, unit: str = YEARLY) -> InputNumber:
    """Moves by a basis point."""
    return InputNumber(unit, text, group, 1e-4, "bp", 1e4)


def share(text: str, group: str, unit: str = "1") -> InputNumber:
    """Moves by a percentage point."""
    return InputNumber(unit, text, group, 0.01, "percentage point", 100.0)


def volatility(text: str) -> InputNumber:
    """Of prices: moves by a percentage point."""
    return share(text, "volatility", SQUARE_ROOT)


def quiet_volatility(text: str) -> InputNumber:
    """Of rates and growth: a percentage point would double it, so that it moves by ten bp."""
    return InputNumber(SQUARE_ROOT, text, "volatility", 1e-3, "bp", 1e4)


def number(meaning: str, group: str, unit: str = "1") -> InputNumber:
    """A pure number, or one without a unit of the trade: moves by 0.01."""
    return InputNumber(unit, meaning, group, 0.01)


def amount(text: str, group: str, unit: str) -> InputNumber:
    """Moves by one per cent of itself."""
    return InputNumber(unit, text, group, None)


def time(text: str, group: str) -> InputNumber:
    """Moves by a year."""
    return InputNumber("year", text, group, 1.0, "year")
