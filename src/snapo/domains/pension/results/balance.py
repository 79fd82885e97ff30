"""Today's balance sheet: key rates of assets, swaps and liabilities; trades; and collateral.

All numbers are in closed form on today's curve; no path is simulated.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Array
from scipy.optimize import toms748

from snapo.problem.quickly import compiled_sooner
from snapo.study.chapter import Floats, Number, floats

from ..fund.collateral import slope, stressed
from ..market.assets.asset_class import log_prices
from ..market.assets.swaps import swap_values
from ..policies.allocation import notionals
from ..records.case import PensionCase
from ..records.market import MarketCurve
from .figures.reconcile import LiabilityFigures

BASIS_POINT = 1e-4
FARTHEST = 2000  # basis points up to which the headroom of collateral is looked for


@dataclass(frozen=True)
class CurveLadder:
    """Change of value for +1 bp at each node of a curve [nodes], in money, for assets, swaps and
    liability.

    - `tenor` [nodes], years; `quote`: the kind of its rates.
    - `real_assets`, `real_liability`: the part that follows the price index, and therefore real
      rates; empty for break-evens.
    """

    label: tuple[str, ...] = ()
    tenor: Floats = floats()
    quote: str = ""
    assets: Floats = floats()
    swaps: Floats = floats()
    liability: Floats = floats()
    real_assets: Floats = floats()
    real_liability: Floats = floats()


@dataclass(frozen=True)
class ClassTrade:
    """The weight of a class now, by the policy, and its bounds; the trade and its cost, in
    money."""

    name: str
    now: Number
    target: Number
    low: Number
    high: Number
    trade: Number
    cost: Number


@dataclass(frozen=True)
class SwapTrade:
    """The notional of a swap now and by the policy, and their difference, in money."""

    tenor: str
    now: Number
    target: Number
    trade: Number


@dataclass(frozen=True)
class TradeList:
    """Today's list of trades from the present weights to the policy's."""

    classes: tuple[ClassTrade, ...]
    swaps: tuple[SwapTrade, ...]


@dataclass(frozen=True)
class Headroom:
    """The move of rates, in basis points, that uses up all eligible assets as collateral.

    - `eligible`: the eligible assets before the move. `pv01`: gain of the swaps of rates for a fall
      by 1 bp.
    - `headroom`: the move; None if swaps do not move with rates at all, or if no move up to
      `FARTHEST` uses up the assets, so that `enough` is true.
    - `direction`: "rise", or "fall" if the swaps together pay the fixed rate.
    - `required`: the move that the case requires.
    """

    eligible: Number = np.nan
    pv01: Number = np.nan
    headroom: float | None = None
    enough: bool = False
    direction: str = "rise"
    required: Number = np.nan


def held_now(case: PensionCase) -> np.ndarray:
    """[n] market values of the classes today."""
    return case.assets.weight.used() * float(case.assets.amount.used())


def slopes(
    curve: MarketCurve, inputs: dict[str, Any], value: Callable[[dict], Array]
) -> np.ndarray:
    """[k, nodes]: d `value` [k] / d quote at a node of `curve`."""

    def shifted(quotes):
        return value(inputs | {curve.rate.name: quotes})

    with jax.enable_x64(True):
        return np.asarray(compiled_sooner(jax.jacrev(shifted))(np.asarray(curve.rate.values)))


def ladder(
    case: PensionCase, values: dict[str, Any], figure: LiabilityFigures, notional: np.ndarray
) -> CurveLadder:
    """The ladder of nominal rates, with break-evens held fixed.

    Classes with a separate shock count as insensitive to the curve.
    """
    linked = np.array([class_.linked for class_ in case.assets.classes])
    prices = case.liability.future_indexation == "full"
    liability = np.asarray(figure.key_rate)
    return replace(
        _ladder(case, case.curve, values, notional, liability),
        real_assets=_by_node(case, case.curve, values, linked),
        real_liability=liability * prices,
    )


def inflation_ladder(
    case: PensionCase, values: dict[str, Any], figure: LiabilityFigures, notional: np.ndarray
) -> CurveLadder:
    """The ladder of break-evens (IE01): changes for +1 bp at each node, with nominal rates held
    fixed."""
    liability = np.asarray(figure.key_inflation)
    return _ladder(case, case.inflation.break_even, values, notional, liability)


def _ladder(
    case: PensionCase,
    curve: MarketCurve,
    values: dict[str, Any],
    notional: np.ndarray,
    liability: np.ndarray,
) -> CurveLadder:
    swaps = np.zeros(len(curve.tenor))
    if case.overlay is not None:
        value = slopes(curve, values, lambda moved: swap_values(case, moved))
        swaps = BASIS_POINT * notional @ value
    assets = _by_node(case, curve, values, np.ones(len(case.assets.classes)))
    labels = tuple(curve.rate.labels)
    return CurveLadder(labels, curve.tenor, curve.quote, assets, swaps, liability)


def _by_node(
    case: PensionCase, curve: MarketCurve, values: dict, counted: np.ndarray
) -> np.ndarray:
    """[nodes]: change of value for +1 bp of the classes that are `counted` [n]."""
    held = slopes(curve, values, lambda moved: log_prices(case, moved))
    return BASIS_POINT * (counted * held_now(case)) @ held


def trades(
    case: PensionCase, weights: np.ndarray, positions: np.ndarray, values: np.ndarray
) -> TradeList:
    """The trades of the classes to `weights` [n], and of the swaps to their `positions` between
    limits [b]."""
    amount, now = float(case.assets.amount.used()), case.assets.weight.used()
    cost = case.assets.cost.used() if case.assets.cost.values.size else np.zeros(len(now))
    classes = tuple(
        ClassTrade(
            class_.name,
            now=now[i],
            target=weights[i],
            low=case.assets.low[i],
            high=case.assets.high[i],
            trade=(weights[i] - now[i]) * amount,
            cost=abs(weights[i] - now[i]) * amount * cost[i],
        )
        for i, class_ in enumerate(case.assets.classes)
    )
    if case.overlay is None:
        return TradeList(classes, ())
    before, after = case.overlay.notional.values, notionals(case, positions, values)
    swaps = tuple(
        SwapTrade(label, float(before[i]), after[i], after[i] - before[i])
        for i, label in enumerate(case.overlay.notional.labels)
    )
    return TradeList(classes, swaps)


def headroom(case: PensionCase, weights: np.ndarray, notional: np.ndarray) -> Headroom | None:
    """The largest move of rates that the collateral withstands, with assets and swaps revalued (see
    `fund.collateral`); None without swaps."""
    if case.overlay is None:
        return None
    held = float(case.assets.amount.used()) * weights
    owed = notional * slope(case)
    rates = case.buckets - case.overlay.inflation
    sign = -1.0 if owed.sum() < 0 else 1.0

    def missing(moves: np.ndarray) -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(stressed(case, sign * BASIS_POINT * moves).gap(held, notional))

    room = _first(missing) if owed.any() else None
    return Headroom(
        eligible=max(float(stressed(case, 0.0).cover @ held), 0.0),
        pv01=BASIS_POINT * float(owed[:rates].sum()),
        headroom=room,
        enough=bool(owed.any()) and room is None,
        direction="fall" if sign < 0 else "rise",
        required=float(case.overlay.collateral_stress.used()) / BASIS_POINT,
    )


def _first(missing: Callable[[np.ndarray], np.ndarray]) -> float | None:
    """The first number of basis points at which collateral is missing; None up to `FARTHEST`."""
    complete = np.arange(FARTHEST + 1.0)
    short = missing(complete) >= 0
    if not short.any():
        return None
    last = int(np.argmax(short))
    if not last:
        return 0.0
    endpoints = (last - 1.0, float(last))
    return toms748(lambda x: float(missing(np.array(x))), *endpoints, xtol=1e-10)  # pyright: ignore
