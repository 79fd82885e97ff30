"""Today's balance sheet: key rates of assets, swaps and liabilities, trades, collateral, stresses.

All of it is closed form on today's curve; no path is simulated.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from ..fund.swap_limits import notionals
from ..market.assets.asset_class import log_prices
from ..market.assets.swaps import swap_log_prices
from ..records.case import PensionCase
from ..records.market import Curve
from .figures.reconcile import Figures

BASIS_POINT = 1e-4
LINKED = "index-linked"


def held_now(case: PensionCase) -> np.ndarray:
    """[n] market values of the classes today."""
    return case.assets.weight.used() * float(case.assets.amount.used())


def slopes(curve: Curve, inputs: dict[str, Any], log_prices: Callable[[dict], Array]) -> np.ndarray:
    """[k, nodes]: d ln price / d quote at a node of `curve`; `log_prices` [k] at given inputs."""

    def prices(quotes):
        return log_prices(inputs | {curve.rate.name: quotes})

    with jax.enable_x64(True):
        return np.asarray(jax.jacrev(prices)(np.asarray(curve.rate.values)))


def ladder(
    case: PensionCase, given: dict[str, Any], figure: Figures, notional: np.ndarray
) -> dict[str, Any]:
    """Change of value for +1 bp at each node of the curve: assets, swaps, liabilities [nodes].

    Classes with a shock of their own count as insensitive to the curve; break-evens are held.
    `real_assets`, `real_liability`: the part of what pays the price index, so of real rates.
    """
    linked = np.array([each.kind == LINKED for each in case.assets.classes])
    prices = case.liability.future_indexation == "full"
    liability = np.asarray(figure.key_rate)
    return _ladder(case, case.curve, given, notional, liability) | {
        "real_assets": _by_node(case, case.curve, given, linked),
        "real_liability": liability * prices,
    }


def inflation_ladder(
    case: PensionCase, given: dict[str, Any], figure: Figures, notional: np.ndarray
) -> dict[str, Any]:
    """IE01: the same for +1 bp at each node of the break-evens, nominal rates held."""
    liability = np.asarray(figure.key_inflation)
    return _ladder(case, case.inflation.break_even, given, notional, liability)


def _ladder(
    case: PensionCase,
    curve: Curve,
    given: dict[str, Any],
    notional: np.ndarray,
    liability: np.ndarray,
) -> dict[str, Any]:
    swaps = np.zeros(len(curve.tenor))
    if case.overlay is not None:
        bonds = slopes(curve, given, lambda moved: swap_log_prices(case, moved))
        swaps = BASIS_POINT * notional @ bonds
    return {
        "label": list(curve.rate.labels),
        "tenor": curve.tenor,
        "quote": curve.quote,
        "assets": _by_node(case, curve, given, np.ones(len(case.assets.classes))),
        "swaps": swaps,
        "liability": liability,
    }


def _by_node(case: PensionCase, curve: Curve, given: dict, counted: np.ndarray) -> np.ndarray:
    """[nodes]: change of value for +1 bp of the classes that are `counted` [n]."""
    held = slopes(curve, given, lambda moved: log_prices(case, moved))
    return BASIS_POINT * (counted * held_now(case)) @ held


def trades(case: PensionCase, weights: np.ndarray, places: np.ndarray, values: np.ndarray) -> Any:
    """Today's list of trades from the present weights to the policy's."""
    amount, now = float(case.assets.amount.used()), case.assets.weight.used()
    cost = case.assets.cost.used() if case.assets.cost.values.size else np.zeros(len(now))
    rows = [
        {
            "name": each.name,
            "now": now[i],
            "target": weights[i],
            "low": case.assets.low[i],
            "high": case.assets.high[i],
            "trade": (weights[i] - now[i]) * amount,
            "cost": abs(weights[i] - now[i]) * amount * cost[i],
        }
        for i, each in enumerate(case.assets.classes)
    ]
    swaps = []
    if case.overlay is not None:
        wanted = notionals(case, places, values)
        for i, label in enumerate(case.overlay.notional.labels):
            before = float(case.overlay.notional.values[i])
            swaps.append({"tenor": label, "now": before, "target": wanted[i]})
            swaps[-1]["trade"] = wanted[i] - before
    return {"classes": rows, "swaps": swaps}


def headroom(case: PensionCase, weights: np.ndarray, notional: np.ndarray) -> dict[str, Any] | None:
    """How far rates may move until eligible assets are used up as collateral, in basis points.

    With swaps of inflation, break-evens fall by as much at the same time. `direction` is "rise",
    or "fall" where swaps in sum pay the fixed rate; `headroom` is None where they do not move with
    rates at all.
    """
    if case.overlay is None:
        return None
    amount = float(case.assets.amount.used())
    counted = sum(w * each.eligible for w, each in zip(weights, case.assets.classes))
    eligible = amount * max(counted, 0.0)
    years = case.overlay.maturity * case.step
    exposure, rates = float(np.sum(notional * years)), case.buckets - case.overlay.inflation
    stress = float(case.overlay.collateral_stress.used())
    return {
        "eligible": eligible,
        "pv01": BASIS_POINT * float(np.sum((notional * years)[:rates])),
        "headroom": eligible / abs(exposure) / BASIS_POINT if exposure else None,
        "direction": "fall" if exposure < 0 else "rise",
        "required": stress / BASIS_POINT,
    }
