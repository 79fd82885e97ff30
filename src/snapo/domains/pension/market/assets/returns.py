"""Returns of all asset classes and swaps over a step: exact, and martingales under "Q"."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from ...records.case import PensionModel
from ...records.inputs import use
from ..currencies import currency_terms
from ..factors import MarketFactors, Moments
from ..shocks import slots
from .appraisal import appraised
from .asset_class import AssetMixture, Now, Scene, by_kind, in_order
from .swaps import swap_mixture, swap_returns, swap_schedule


class AssetTerms(NamedTuple):
    """`kinds` one entry per kind (see `AssetClass.prepare`), `swaps` or None; `exposure` [X] the
    volatility of the unhedged share of a currency; `smoothing` [q]."""

    kinds: tuple[Any, ...]
    swaps: Any
    exposure: Array
    smoothing: Array


class AssetSteps(NamedTuple):
    """The same per step."""

    kinds: tuple[Any, ...]
    swaps: Any


class Returns(NamedTuple):
    """Over one step: `log` [n] log returns as shown, `swaps` [b] log returns over cash, `reported`
    [q] of the next step; `beneath` the bonds of each kind and of the swaps, None where log returns
    are Gaussian themselves."""

    log: Array
    swaps: Array | None
    reported: Array | None
    beneath: tuple[AssetMixture | None, ...]


def asset_schedule(
    case: PensionModel,
    inputs: dict[str, Any],
    factors: MarketFactors,
    covariance: Float[Array, "Z Z"],
    moments: Moments,
) -> tuple[AssetTerms, AssetSteps]:
    """The numbers of all classes that paths share; `moments` of nominal bonds."""
    currencies = currency_terms(case, inputs)
    scene = Scene(case, inputs, factors, covariance, currencies, moments)
    kinds = [kind.prepare(scene, positions) for kind, positions in by_kind(case)]
    swaps = (None, None) if case.overlay is None else swap_schedule(scene)
    smoothing = use(inputs, case.assets.smoothing)
    terms = AssetTerms(tuple(t for t, _ in kinds), swaps[0], currencies.exposure, smoothing)
    return terms, AssetSteps(tuple(s for _, s in kinds), swaps[1])


def returns(case: PensionModel, terms: AssetTerms, now, market, shock, cash) -> Returns:
    """Log returns of all classes; `now` the step's `MarketSteps`, `market` the state before it,
    `shock` [Z] the Gaussian vector, `cash` the log return of cash."""
    foreign = terms.exposure * shock[slots(case).currency] if case.currencies.names else None
    observed = Now(
        shock, now.volatility, now.index_volatility, cash, market.factors, market.spread, foreign
    )
    held = list(zip(by_kind(case), terms.kinds, now.assets.kinds))
    parts = [kind.log_return(case, at, term, step, observed) for (kind, at), term, step in held]
    beneath = [kind.mixture(case, at, term, step, observed) for (kind, at), term, step in held]
    log, displayed = appraised(case, terms.smoothing, in_order(case, parts), market.reported)
    swaps = None
    if case.buckets:
        beneath.append(swap_mixture(case, terms.swaps, now.assets.swaps, observed))
        swaps = swap_returns(case, terms.swaps, now.assets.swaps, observed)
    return Returns(log, swaps, displayed, tuple(beneath))
