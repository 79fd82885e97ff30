"""Bonds of a constant maturity: government, index-linked and coupon bonds, without default.

Index-linked bonds are zero-coupon bonds of constant maturity that pay the price index. The value of
a bond of u years is I(t) P_real(t, t + u) in money, where P_real discounts by the real rate (R.
Jarrow, Y. Yildirim, JFQA 38, 2003, with Gaussian rates); its return over a step follows (see
`constant_maturity`). Indexation has no lag, and the principal has no floor. Coupon bonds have a
fixed coupon or are at par. After each step they are sold, and bonds of the original maturity with
the same coupon are bought; at par, the coupon is the one at which the path's curve values the bonds
at their principal.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.case.csv import Row
from snapo.problem.record.arrays import Array
from snapo.problem.record.either import xp

from ...read.cells import whole_steps
from ...records.assets import AttributionPart
from ...records.case import PensionModel
from ..bonds import constant_maturity, strips
from ..bonds.payments import AT_PAR, Payments, payments, zero_coupon
from .asset_class import AssetClass, AssetNames, register


class BondTerms(NamedTuple):
    """`reach` [k, f], see `constant_maturity`."""

    reach: Array


class BondSteps(NamedTuple):
    """`drift` [T, k] of log returns over cash."""

    drift: Array


@dataclass(frozen=True)
class Maturing(AssetClass):
    """Zero-coupon bonds of a constant maturity of `maturity` whole steps."""

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


@register
@dataclass(frozen=True)
class IndexLinked(Bond):
    """Zero-coupon bonds on the real curve, without default."""

    kind: ClassVar[str] = "index-linked"
    description: ClassVar[str] = (
        "zero-coupon bonds of constant maturity that pay the price index, discounted on the curve"
        " minus break-evens"
    )
    without: ClassVar[str] = "its return follows from the curve and the break-evens"
    risk: ClassVar[str] = "none"
    linked: ClassVar[bool] = True

    @classmethod
    def held(cls, case, positions) -> constant_maturity.HeldBonds:
        values = cls.maturities(case, positions), cls.currencies(case, positions)
        return constant_maturity.linked_bonds(case, *values)


PAR = "par"


@register
@dataclass(frozen=True)
class CouponBond(Maturing):
    """Bonds that pay a `coupon` per year, `AT_PAR` for the par rate."""

    kind: ClassVar[str] = "coupon-bond"
    description: ClassVar[str] = (
        "bonds of constant maturity on the nominal curve that pay a coupon once a year"
    )
    columns: ClassVar[tuple[str, ...]] = ("maturity", "coupon")
    without: ClassVar[str] = "its return follows from the curve"
    part: ClassVar[AttributionPart] = "rates"
    risk: ClassVar[str] = "none"
    collateral: ClassVar[float] = 1.0

    coupon: float = AT_PAR

    @classmethod
    def read(cls, row: Row, names: AssetNames) -> dict[str, Any]:
        text = row.cells.setdefault("coupon", "").strip()
        if not text:
            raise row.error("coupon", f'it must be a rate per year or "{PAR}"')
        coupon = AT_PAR if text == PAR else row.number("coupon", 0.0, 1.0)
        return super().read(row, names) | {"coupon": coupon}

    @classmethod
    def payments(cls, case: PensionModel, positions) -> Payments:
        coupons = [item.coupon for item in cls.of(case, positions)]
        return payments(cls.maturities(case, positions), coupons, case.step)

    @classmethod
    def prepare(cls, scene, positions):
        case = scene.case
        return strips.prepare(scene, cls.payments(case, positions), cls.currencies(case, positions))

    @classmethod
    def mixture(cls, case, positions, terms, steps, now):
        due, currency = cls.payments(case, positions), cls.currencies(case, positions)
        return strips.mixture(case, due, currency, terms, steps, now)

    @classmethod
    def log_return(cls, case, positions, terms, steps, now):
        due, currency = cls.payments(case, positions), cls.currencies(case, positions)
        return xp.log1p(strips.gains(case, due, currency, terms, steps, now)) + now.cash
