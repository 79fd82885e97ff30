"""The figures by which a user recognises a fund: its size, durations, volatilities and returns."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.either import scan, slope, with_numpy, xp

from ...market.assets.asset_class import log_prices
from ...market.assets.swaps import swap_values
from ...market.correlation import matrix
from ...market.curve import log_bond
from ...market.dynamics import market_schedule, move
from ...market.shocks import reach, slots
from ...market.state import without_empty
from ...records.case import PensionCase
from ...records.market import MarketCurve
from .reconcile import BASIS_POINT, LiabilityFigures

TENORS = (1, 10, 30)  # years at which rates are reported


class Human(NamedTuple):
    """Figures that follow from today's curve and from the models, before any simulation.

    - `assets`, `liability`: money; `funding`: their ratio, None without a liability.
    - `duration`: the duration of the liability; `asset_duration`: the duration of assets with
      swaps, relative to assets; both in years, for a parallel shift of the curve. `hedge_ratio`:
      the change of assets and swaps divided by that of the liability for this shift; None if the
      liability does not follow the curve. `inflation_hedge_ratio`: the same for a rise of all
      break-evens, with nominal rates held fixed.
    - `rate`, `rate_volatility`: continuous zero rates, and the standard deviation of their change
      in a year at today's volatility, for each of `TENORS`. `rate_volatility` is empty under
      supplied scenarios.
    - `returns`: {class: geometric return per year over the horizon}, on the path without shocks;
      under supplied scenarios the mean of the training paths.
    """

    assets: float
    liability: float
    funding: float | None
    duration: float
    asset_duration: float
    hedge_ratio: float | None
    inflation_hedge_ratio: float | None
    rate: dict[int, float]
    rate_volatility: dict[int, float]
    returns: dict[str, float]


def human(case: PensionCase, inputs: dict[str, Any], figures: LiabilityFigures) -> Human:
    """All of these figures; `figures` are the case's `reconcile.figures`."""
    assets, liability = float(case.assets.amount.used()), figures.liability
    held = _parallel(case, inputs, case.curve)
    linked = _parallel(case, inputs, case.inflation.break_even)
    rates = -with_numpy(log_bond)(case.curve, inputs, np.array(TENORS)) / TENORS
    volatility = {} if case.scenarios is not None else _rate_volatility(case, inputs)
    grown = _supplied(case) if case.scenarios is not None else _median(case, inputs)
    owed = float(np.sum(figures.key_rate)) / BASIS_POINT
    promised = figures.inflation01 / BASIS_POINT
    return Human(
        assets=assets,
        liability=liability,
        funding=assets / liability if liability else None,
        duration=figures.duration,
        asset_duration=-held / assets,
        hedge_ratio=held / owed if owed else None,
        inflation_hedge_ratio=linked / promised if promised else None,
        rate=dict(zip(TENORS, rates.tolist())),
        rate_volatility=volatility,
        returns=dict(zip((class_.name for class_ in case.assets.classes), grown.tolist())),
    )


def _parallel(case: PensionCase, values: dict[str, Any], curve: MarketCurve) -> float:
    """d (assets and swaps today) / d shift of all quotes of `curve`, in money."""
    name, quotes = curve.rate.name, curve.rate.values

    def value(shift):
        moved = values | {name: quotes + shift}
        held = case.assets.weight.used() * float(case.assets.amount.used())
        total = held @ log_prices(case, moved)
        if case.overlay is not None:
            total = total + case.overlay.notional.used() @ swap_values(case, moved)
        return total

    return float(slope(value, 0.0))


def _rate_volatility(case: PensionCase, values: dict[str, Any]) -> dict[int, float]:
    """The volatilities of rates of Gaussian factors: a zero rate of u years moves by B(u) / u times
    each of them."""
    count, now = case.rates.count(), case.rates.volatility.used()[0]

    def deviations():
        together = matrix(case, values)[:count, :count]
        loads = [now * reach(case.rates.mean_reversion.used(), float(u)) / u for u in TENORS]
        return [xp.sqrt(load @ together @ load) for load in loads]

    return dict(zip(TENORS, map(float, with_numpy(deviations)())))


def _median(case: PensionCase, values: dict[str, Any]) -> np.ndarray:
    """[n] returns per year along the path on which every shock is zero."""
    # Bases, mortality and swaps do not matter to returns.
    market = replace(case, lee_carter=None, overlay=None)

    def simulate():
        terms, steps, _ = market_schedule(market, values, np.array([round(1 / case.step)]))
        terms, steps = without_empty(terms), without_empty(steps)
        none = xp.zeros(slots(market).size)

        def step(state, now):
            moved = move(market, terms, now, state, none)
            return moved.market, moved.gross

        return scan(step, terms.start, steps, case.steps)[1]

    gross = with_numpy(simulate)()
    return np.expm1(np.log(gross).mean(0) / case.step)


def _supplied(case: PensionCase) -> np.ndarray:
    """The returns per year [n] of ready-made paths, from their mean log returns."""
    assert case.scenarios is not None
    simple = case.scenarios.training[:, :, : len(case.assets.classes)]
    return np.expm1(np.log1p(simple).mean((0, 1)) / case.step)
