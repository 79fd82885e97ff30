"""Bonds by their maturity: the column of the table, and today's prices by the curve."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from snapo.case.csv import Row

from ...read.cells import whole_steps
from ...records.case import PensionCase
from ..curve import log_bond
from .asset_class import AssetClass, Names


@dataclass(frozen=True)
class Maturing(AssetClass):
    """Zero-coupon bonds of `maturity` whole steps, kept constant."""

    maturity: int = 0

    @classmethod
    def read(cls, row: Row, names: Names) -> dict[str, Any]:
        row.cells.setdefault("maturity", "")
        return {"maturity": whole_steps(row, "maturity", names.step)}

    @classmethod
    def maturities(cls, case: PensionCase, places) -> np.ndarray:
        """[k] in steps."""
        return np.array([each.maturity for each in cls.of(case, places)], int)

    @classmethod
    def log_price(cls, case: PensionCase, inputs: dict[str, Any], places) -> Float[Array, " k"]:
        """By the nominal curve alone."""
        return log_bond(case.curve, inputs, cls.maturities(case, places) * case.step)
