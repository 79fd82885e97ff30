"""Coupon bonds: on the nominal curve, without default, with a fixed coupon or at par.

After each step they are sold, and bonds of the first maturity and of the same coupon are bought; at
par, of the coupon at which the path's curve values them at their principal.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp

from snapo.case.csv import Row

from ...records.assets import AttributionPart
from ...records.case import PensionModel
from ..bonds import strips
from ..bonds.payments import AT_PAR, Payments, payments
from .asset_class import AssetNames, register
from .bond import Maturing

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
            raise row.error("coupon", f'a rate per year or "{PAR}" is needed')
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
        return jnp.log1p(strips.gains(case, due, currency, terms, steps, now)) + now.cash
