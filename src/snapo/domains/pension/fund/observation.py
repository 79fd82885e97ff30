"""The observation of a pension fund: parts with names, of order one, in the order of the case.
Logarithms of ratios are divided by `RATIO`, rates by `RATE`, and the factors of the models by their
standard deviations over ten years.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.case import PensionModel

if TYPE_CHECKING:
    from .books import FundState
    from .schedule import FundTerms, Period

RATIO = 0.2  # of ln F: a number of order one is a fifth of the funding ratio
RATE = 0.02
MIN_RATIO = 1e-3  # the logarithm's argument stays above this where assets are gone


class View(NamedTuple):
    """One path at the start of a step; `ratio` is the funding ratio F."""

    case: PensionModel
    terms: "FundTerms"
    now: "Period"
    state: "FundState"
    ratio: Array


def _one(case: PensionModel) -> int:
    return 1


def _yes(case: PensionModel) -> bool:
    return True


def _no(case: PensionModel) -> bool:
    return False


@dataclass(frozen=True)
class Feature:
    """A part of the observation: the numbers that belong to one name.

    - `see`: computes its numbers from a `View`. `size`: the length of the part in a case.
    - `usual`: whether a policy observes it by default.
    """

    see: Callable[[View], Any]
    size: Callable[[PensionModel], int] = _one
    usual: Callable[[PensionModel], bool] = _yes


def _generated(case: PensionModel) -> bool:
    return case.scenarios is None


def _ready_made(case: PensionModel) -> bool:
    return case.scenarios is not None


def _rate_count(case: PensionModel) -> int:
    return case.rates.count() if case.scenarios is None else len(case.scenarios.tenors)


def _rates(view: View) -> Array:
    factors = view.state.market.factors
    if view.case.scenarios is not None:
        return factors / RATE
    return factors[:-1] / view.terms.scales.factors[:-1]


def _level(position: int) -> Callable[[View], Array]:
    """The long (0) or short (1) rate."""

    def see(view: View) -> Array:
        market = view.terms.market
        slopes = market.rate_slope @ view.state.market.factors
        return ((view.now.market.rate_level + slopes) / RATE)[position]

    return see


def _ratio(view: View) -> Array:
    return xp.where(view.ratio > MIN_RATIO, view.ratio, MIN_RATIO)


def _relative(view: View) -> Array:
    return xp.log(_ratio(view) / (view.terms.assets / view.terms.liability)) / RATIO


FEATURES: dict[str, Feature] = {
    "time": Feature(lambda view: 2 * view.now.time - 1),
    "funding_ratio": Feature(lambda view: xp.log(_ratio(view)) / RATIO),
    # The funding ratio itself is there already.
    "relative_funding": Feature(_relative, usual=_no),
    "rates": Feature(_rates, _rate_count, _generated),
    "long_rate": Feature(_level(0), usual=_ready_made),
    "short_rate": Feature(_level(1), usual=_ready_made),
    "inflation": Feature(
        lambda view: view.state.market.factors[-1] / view.terms.scales.factors[-1],
        lambda case: int(_generated(case)),
        _generated,
    ),
    "realised_inflation": Feature(
        lambda view: (view.state.market.log_price - view.state.log_price_last) / RATE
    ),
    "spreads": Feature(
        lambda view: view.state.market.spread / view.terms.scales.spread,
        lambda case: len(case.credit.names) if _generated(case) else 0,
        lambda case: bool(case.credit.names) and _generated(case),
    ),
    "mortality": Feature(
        lambda view: view.state.market.mortality / view.terms.scales.mortality,
        usual=lambda case: case.lee_carter is not None,
    ),
    "weights": Feature(lambda view: view.state.weights, lambda case: len(case.assets.classes)),
    "overlay": Feature(
        lambda view: view.state.overlay,
        lambda case: case.buckets,
        lambda case: case.overlay is not None,
    ),
    "accrued": Feature(lambda view: xp.log(view.state.theta) / RATIO, usual=_no),
}


def slots(case: PensionModel) -> dict[str, slice]:
    """The slice of each observed name in the observation."""
    slices, start = {}, 0
    for name in case.observation:
        stop = start + FEATURES[name].size(case)
        slices[name] = slice(start, stop)
        start = stop
    return slices


def observe(
    case: PensionModel, terms: "FundTerms", now: "Period", state: "FundState", ratio: Array
) -> Float[Array, " features"]:
    """The observation of one path at the start of a step; `ratio` is the funding ratio F."""
    view = View(case, terms, now, state, ratio)
    observed = [FEATURES[name] for name in case.observation if FEATURES[name].size(case)]
    return xp.concatenate([xp.reshape(feature.see(view), (-1,)) for feature in observed])
