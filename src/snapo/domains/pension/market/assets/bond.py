"""Bonds by their maturity, and government bonds: on the nominal curve, without default."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Array

from snapo.case.csv import Row

from ...read.cells import whole_steps
from ...records.assets import AttributionPart
from ...records.case import PensionModel
from ..bonds import constant_maturity
from ..bonds.payments import Payments, zero_coupon
from .asset_class import AssetClass, AssetNames, register


class BondTerms(NamedTuple):
    """`reach` [k, f], see `constant_maturity`."""

    reach: Array


class BondSteps(NamedTuple):
    """`drift` [T, k] of log returns over cash."""

    drift: Array


@dataclass(frozen=True)
class Maturing(AssetClass):
    """Zero-coupon bonds of `maturity` whole steps, kept constant."""

    maturity: int = 0

    @classmethod
    def read(cls, row: Row, names: AssetNames) -> dict[str, Any]:
        row.cells.setdefault("maturity", "")
        return {"maturity": whole_steps(row, "maturity", names.step)}

    @classmethod
    def maturities(cls, case: PensionModel, positions) -> np.ndarray:
        """[k] in steps."""
        return np.array([item.maturity for item in cls.of(case, positions)], int)

    @classmethod
    def payments(cls, case: PensionModel, positions) -> Payments:
        """The principal at maturity."""
        return zero_coupon(cls.maturities(case, positions), case.step)


@register
@dataclass(frozen=True)
class Bond(Maturing):
    """Zero-coupon bonds without default."""

    kind: ClassVar[str] = "bond"
    description: ClassVar[str] = "zero-coupon bonds of constant maturity on the nominal curve"
    columns: ClassVar[tuple[str, ...]] = ("maturity",)
    without: ClassVar[str] = "its return follows from the curve"
    part: ClassVar[AttributionPart] = "rates"
    risk: ClassVar[str] = "none"
    collateral: ClassVar[float] = 1.0

    @classmethod
    def held(cls, case, positions) -> constant_maturity.HeldBonds:
        """The bonds at these positions."""
        values = cls.maturities(case, positions), cls.currencies(case, positions)
        return constant_maturity.nominal_bonds(case, *values)

    @classmethod
    def prepare(cls, scene, positions):
        held = cls.held(scene.case, positions)
        drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
        reach = constant_maturity.reach(held, scene.factors, scene.case.step)
        return BondTerms(reach), BondSteps(drift)

    @classmethod
    def log_return(cls, case, positions, terms, steps, now):
        held = cls.held(case, positions)
        over = constant_maturity.over_cash(case, held, terms.reach, steps.drift, now)
        return over + now.cash
