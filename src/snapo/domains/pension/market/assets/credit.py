"""Corporate bonds: the curve plus a rating's spread, minus defaults.

The log return over that of a default-free bond of the same maturity is minus the duration times the
change of the spread s = mean exp(u), where the noise of the spread is made a martingale. In the
real world the bond earns the spread minus defaults, and minus the fall of its price while u reverts
to zero.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import xp

from ...records.assets import AttributionPart
from ...records.inputs import use
from ..bonds import constant_maturity
from ..shocks import slots
from ..spreads import spread_terms
from .asset_class import register
from .bond import Maturing


class CreditTerms(NamedTuple):
    """Terms of the k classes: `reach` [k, f]: that of the underlying bond; `duration`: in years;
    `mean_spread`: the mean spread; `volatility`, `variance`: those of the shock zeta of the spread;
    `carry`: the return per unit of spread and step; `reverting`: the share of u that disappears in
    a step."""

    reach: Array
    duration: Array
    mean_spread: Array
    volatility: Array
    variance: Array
    carry: Array
    reverting: Array


class CreditSteps(NamedTuple):
    """[T, k]: `drift` of the underlying bond over cash, `cross` the covariance of its return with
    the spread's zeta."""

    drift: Array
    cross: Array


@register
@dataclass(frozen=True)
class CreditBond(Maturing):
    """Zero-coupon corporate bonds; `rating`: position in the ratings of the case."""

    kind: ClassVar[str] = "credit"
    description: ClassVar[str] = (
        "zero-coupon corporate bonds of constant maturity: the curve plus a rating's spread,"
        " minus defaults"
    )
    columns: ClassVar[tuple[str, ...]] = ("maturity", "rating")
    without: ClassVar[str] = "its return follows from the curve and the spread of its rating"
    part: ClassVar[AttributionPart] = "credit"
    risk: ClassVar[str] = "none"

    rating: int = -1

    @classmethod
    def read(cls, row, names):
        if not row.cells.setdefault("rating", ""):
            raise row.error("rating", "a class of kind credit needs a rating")
        return super().read(row, names) | {"rating": names.rating(row)}

    @classmethod
    def ratings(cls, case, positions):
        return np.array([item.rating for item in cls.of(case, positions)], int)

    @classmethod
    def held(cls, case, positions) -> constant_maturity.HeldBonds:
        """The bonds without their spreads."""
        values = cls.maturities(case, positions), cls.currencies(case, positions)
        return constant_maturity.nominal_bonds(case, *values)

    @classmethod
    def prepare(cls, scene, positions):
        case, inputs, held = scene.case, scene.inputs, cls.held(scene.case, positions)
        load, rating = constant_maturity.load(scene, held), cls.ratings(case, positions)
        component = slots(case).spread.start + rating
        credit, real_world = case.credit, 0.0 if case.risk_neutral else 1.0
        mean = use(inputs, credit.mean_spread)
        lost = use(inputs, credit.default_loss) / mean
        spread = spread_terms(case, inputs)
        terms = CreditTerms(
            reach=constant_maturity.reach(held, scene.factors, case.step),
            duration=xp.asarray(held.maturity * case.step),
            mean_spread=mean[rating],
            volatility=spread.volatility[rating],
            variance=xp.diag(scene.covariance)[component],
            carry=real_world * (1 - lost)[rating] * case.step,
            reverting=real_world * (1 - spread.fading)[rating],
        )
        steps = CreditSteps(
            drift=constant_maturity.drift(scene, held, load),
            cross=load.with_component(scene.covariance, component),
        )
        return terms, steps

    @classmethod
    def log_return(cls, case, positions, terms, steps, now):
        held, rating = cls.held(case, positions), cls.ratings(case, positions)
        bond = constant_maturity.over_cash(case, held, terms.reach, steps.drift, now)
        assert now.spread is not None
        u, zeta = now.spread[rating], now.shock[slots(case).spread][rating]
        level = terms.mean_spread * xp.exp(u)
        move = -terms.duration * level
        shocked = move * terms.volatility
        noise = zeta - steps.cross - shocked * terms.variance / 2
        extra = shocked * noise + level * terms.carry - move * terms.reverting * u
        return bond + extra + now.cash

    @classmethod
    def log_price(cls, case, inputs: dict[str, Any], positions):
        years = cls.maturities(case, positions) * case.step
        spread = use(inputs, case.credit.spread)[cls.ratings(case, positions)]
        return super().log_price(case, inputs, positions) - years * spread
