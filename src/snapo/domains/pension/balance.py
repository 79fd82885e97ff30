"""Today's balance sheet: key rates of assets, swaps and liabilities, trades, collateral, stresses.

Everything here is closed form on today's curve; no path is simulated.
"""

from typing import Any

import jax
import numpy as np

from snapo.problem.inputs import Input, plain
from snapo.problem.prepare import prepare
from snapo.solver.adjoint import adjoint_jacobian

from .books import balance, opening
from .curve import log_bond
from .inputs import pension_inputs, use
from .reconcile import Figures, figures
from .records import Curve, PensionCase
from .simulator import PensionSimulator
from .stress import Stressed

BASIS_POINT = 1e-4


def held_now(case: PensionCase) -> np.ndarray:
    """[n] market values of the classes today."""
    return case.assets.weight.used() * float(case.assets.amount.used())


def notionals(case: PensionCase, places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """[b] notionals where the policy puts them, from their `places` in the ranges, 0 to 1.

    `values`: [b] what limits are shares of: the assets, or the liability nearest to each bucket.
    """
    overlay = case.overlay
    if overlay is None:
        return np.zeros(0)
    shares = overlay.low + places * (overlay.high - overlay.low)
    wanted = shares * values
    assets = float(case.assets.amount.used())
    total, most = np.abs(wanted).sum() / assets, float(overlay.leverage.used())
    return wanted * min(1.0, most / total) if total > 0 else wanted


def limit_unit(case: PensionCase) -> np.ndarray:
    """[b] money that the limits of the swaps are shares of today: all assets, or the liability
    payments nearest to each bucket."""
    if case.overlay is None or case.overlay.unit == "assets":
        return np.full(case.buckets, float(case.assets.amount.used()))
    simulator = PensionSimulator(case)  # pyright: ignore[reportCallIssue]
    schedule = prepare(simulator, pension_inputs(case))
    terms, steps = schedule.constants, schedule.steps
    people = jax.tree.map(lambda rows: rows[0], steps.people)
    with jax.enable_x64(True):
        books = balance(case, terms, people, steps.shape[0], opening(terms))
        return np.asarray(terms.swaps.nearest @ books.by_node)


def years_of(case: PensionCase) -> np.ndarray:
    """[n] maturities in years, 0 where a class has none."""
    return np.array([each.maturity * case.step for each in case.assets.classes])


def curve_slopes(case: PensionCase, curve: Curve, inputs: dict, years: np.ndarray) -> np.ndarray:
    """[len(years), nodes]: d ln P(0, year) / d quote at a node."""

    def bonds(quotes):
        return log_bond(curve, inputs | {curve.rate.name: quotes}, years)

    with jax.enable_x64(True):
        return np.asarray(adjoint_jacobian(bonds)(np.asarray(curve.rate.values)))


def ladder(
    case: PensionCase, inputs: dict[str, Input], figure: Figures, notional: np.ndarray
) -> dict[str, Any]:
    """Change of value for +1 bp at each node of the curve: assets, swaps, liabilities [nodes].

    Classes with a shock of their own count as insensitive to the curve.
    """
    given, curve = plain(inputs), case.curve
    years = years_of(case)
    bonds = np.flatnonzero(years)
    slopes = curve_slopes(case, curve, given, years[bonds])
    assets = BASIS_POINT * held_now(case)[bonds] @ slopes
    swaps = np.zeros(len(curve.tenor))
    if case.overlay is not None:
        maturity = case.overlay.maturity * case.step
        swaps = BASIS_POINT * notional @ curve_slopes(case, curve, given, maturity)
    liability = np.asarray(figure.key_rate)
    return {
        "label": list(curve.rate.labels),
        "tenor": curve.tenor,
        "quote": curve.quote,
        "assets": assets,
        "swaps": swaps,
        "liability": liability,
    }


def trades(case: PensionCase, weights: np.ndarray, places: np.ndarray, values: np.ndarray) -> Any:
    """Today's list: what to buy and sell to get from the present weights to the policy's."""
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

    `direction` is "rise", or "fall" where swaps in sum pay the fixed rate; `headroom` is None
    where they do not move with rates at all.
    """
    if case.overlay is None:
        return None
    amount = float(case.assets.amount.used())
    eligible = amount * sum(w * each.eligible for w, each in zip(weights, case.assets.classes))
    exposure = float(np.sum(notional * case.overlay.maturity * case.step))
    stress = float(case.overlay.collateral_stress.used())
    return {
        "eligible": eligible,
        "pv01": BASIS_POINT * exposure,
        "headroom": eligible / abs(exposure) / BASIS_POINT if exposure else None,
        "direction": "fall" if exposure < 0 else "rise",
        "required": stress / BASIS_POINT,
    }


def stressed(
    case: PensionCase, inputs: dict[str, Input], scenario: Stressed, notional: np.ndarray
) -> dict[str, Any]:
    """Assets, liabilities and funding ratio at once after a shock, present holdings kept."""
    before = plain(inputs)
    after = before | {
        name: np.asarray(values, np.float64) for name, values in scenario.values.items()
    }
    ratio = scenario.price * np.exp(_bond_moves(case, before, after))
    assets = float(held_now(case) @ ratio)
    if case.overlay is not None:
        years = case.overlay.maturity * case.step
        assets += float(notional @ np.expm1(_log_change(case, before, after, years)))
    liability = float(figures(case, after).liability)
    return {
        "scenario": scenario.scenario,
        "assets": assets,
        "liability": liability,
        "funding": assets / liability,
        "surplus": assets - liability,
    }


def _log_change(case: PensionCase, before: dict, after: dict, years: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        old, new = (np.asarray(log_bond(case.curve, each, years)) for each in (before, after))
    return new - old


def _bond_moves(case: PensionCase, before: dict, after: dict) -> np.ndarray:
    """[n] log price changes of bonds and credit from the curve and from spreads."""
    years = years_of(case)
    moves = np.zeros(len(years))
    bonds = np.flatnonzero(years)
    moves[bonds] = _log_change(case, before, after, years[bonds])
    if case.credit.names:
        with jax.enable_x64(True):
            spread = [np.asarray(use(each, case.credit.spread)) for each in (before, after)]
        for i, each in enumerate(case.assets.classes):
            if each.kind == "credit":
                moves[i] -= years[i] * float(spread[1][each.rating] - spread[0][each.rating])
    return moves
