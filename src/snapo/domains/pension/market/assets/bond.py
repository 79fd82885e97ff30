"""Government bonds: zero-coupon bonds of constant maturity on the nominal curve."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from jaxtyping import Array

from . import constant_maturity
from .asset_class import AttributionPart, register
from .maturity import Maturing


class BondTerms(NamedTuple):
    """`reach` [k, f], see `constant_maturity`."""

    reach: Array


class BondSteps(NamedTuple):
    """`drift` [T, k] of log returns over cash."""

    drift: Array


@register
@dataclass(frozen=True)
class Bond(Maturing):
    """Zero-coupon bonds without default."""

    kind: ClassVar[str] = "bond"
    words: ClassVar[str] = "zero-coupon bonds of constant maturity on the nominal curve"
    columns: ClassVar[tuple[str, ...]] = ("maturity",)
    without: ClassVar[str] = "its return follows from the curve"
    part: ClassVar[AttributionPart] = "rates"
    collateral: ClassVar[float] = 1.0

    @classmethod
    def held(cls, case, places) -> constant_maturity.Held:
        """The bonds at these positions."""
        given = cls.maturities(case, places), cls.currencies(case, places)
        return constant_maturity.nominal_bonds(case, *given)

    @classmethod
    def prepare(cls, scene, places):
        held = cls.held(scene.case, places)
        drift = constant_maturity.drift(scene, held, constant_maturity.load(scene, held))
        reach = constant_maturity.reach(held, scene.factors, scene.case.step)
        return BondTerms(reach), BondSteps(drift)

    @classmethod
    def log_return(cls, case, places, terms, steps, now):
        held = cls.held(case, places)
        over = constant_maturity.over_cash(case, held, terms.reach, steps.drift, now)
        return over + now.cash
