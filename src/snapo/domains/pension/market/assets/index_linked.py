"""Index-linked bonds: zero-coupon bonds of constant maturity that pay the price index.

The value of a bond of u years is I(t) P_real(t, t + u) in money, where P_real discounts by the
real rate (R. Jarrow, Y. Yildirim, JFQA 38, 2003, with Gaussian rates); its return over a step
follows (see `constant_maturity`). Indexation is without a lag, the principal without a floor.
"""

from dataclasses import dataclass
from typing import ClassVar

from ..bonds import constant_maturity
from .asset_class import register
from .bond import Bond


@register
@dataclass(frozen=True)
class IndexLinked(Bond):
    """Zero-coupon bonds on the real curve, without default."""

    kind: ClassVar[str] = "index-linked"
    description: ClassVar[str] = (
        "zero-coupon bonds of constant maturity that pay the price index, discounted on the curve"
        " less break-evens"
    )
    without: ClassVar[str] = "its return follows from the curve and the break-evens"
    risk: ClassVar[str] = "none"
    linked: ClassVar[bool] = True

    @classmethod
    def held(cls, case, positions) -> constant_maturity.HeldBonds:
        values = cls.maturities(case, positions), cls.currencies(case, positions)
        return constant_maturity.linked_bonds(case, *values)
