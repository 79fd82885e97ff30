"""The fund after each scenario of its file of shocks: which inputs and prices move, and how."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.inputs import plain
from snapo.study.study import StudyRun

from ..market.assets.asset_class import log_prices
from ..market.assets.swaps import swap_values
from ..market.smith_wilson import log_bond
from ..read.stress import CURVES, PRICE, Shock, read_shocks
from ..records.case import PensionCase
from ..records.inputs import every_given
from ..records.market import Curve
from .balance import held_now
from .figures.reconcile import figures
from .setup import case_of

ROUNDS = 8  # of Newton's method; the zero rates of swaps are nearly linear in their rates


def zero_rates(curve: Curve) -> np.ndarray:
    """[n] continuous zero rates at the nodes, whatever is quoted."""
    if curve.quote == "zero":
        return curve.rate.used()
    if curve.quote == "swap":
        with jax.enable_x64(True):
            return np.asarray(_of_swaps(curve, jnp.asarray(curve.rate.used())))
    return np.cumsum(curve.rate.used() * np.diff(curve.tenor, prepend=0.0)) / curve.tenor


def from_zero_rates(curve: Curve, zero: np.ndarray) -> np.ndarray:
    """The quotes of these zero rates: the inverse of `zero_rates`."""
    if curve.quote == "zero":
        return zero
    if curve.quote == "swap":
        return _to_swaps(curve, zero)
    return np.diff(zero * curve.tenor, prepend=0.0) / np.diff(curve.tenor, prepend=0.0)


@partial(jax.jit, static_argnums=0)
def _of_swaps(curve: Curve, rate: Array) -> Array:
    return -log_bond(curve, rate, jnp.asarray(curve.ultimate.used()), curve.tenor) / curve.tenor


@partial(jax.jit, static_argnums=0)
def _closer(curve: Curve, rate: Array, zero: Array) -> Array:
    """The swap rates after a step of Newton's method."""
    missed = _of_swaps(curve, rate) - zero
    return rate - jnp.linalg.solve(jax.jacfwd(_of_swaps, 1)(curve, rate), missed)


def _to_swaps(curve: Curve, zero: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        rate = jnp.asarray(curve.rate.used())
        for _ in range(ROUNDS):
            rate = _closer(curve, rate, jnp.asarray(zero))
        return np.asarray(rate)


def work(run: StudyRun) -> dict[str, Any]:
    """ "stresses": the balance sheet at once after each scenario of the file; none without it."""
    case, inputs = case_of(run), plain(run.setup.problem.inputs)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    every = scenarios(case, read_shocks(case))
    return {"stresses": [stressed(case, inputs, each, now) for each in every]}


@dataclass(frozen=True)
class Stressed:
    """A case after one scenario: numbers of the inputs that moved, and by class the price ratio.

    `values`: {input: [n]}; `price`: [classes], without the losses of bonds to rates and spreads.
    """

    scenario: str
    values: dict[str, np.ndarray]
    price: np.ndarray


def scenarios(case: PensionCase, shocks: Sequence[Shock]) -> list[Stressed]:
    """The scenarios in the order of the file."""
    names = dict.fromkeys(shock.scenario for shock in shocks)
    return [_scenario(case, name, [s for s in shocks if s.scenario == name]) for name in names]


def _scenario(case: PensionCase, name: str, shocks: Sequence[Shock]) -> Stressed:
    given = {each.name: each for each in every_given(case)}
    values: dict[str, np.ndarray] = {}
    price = np.ones(len(case.assets.classes))
    for target, curve in zip(CURVES, (case.curve, case.inflation.break_even)):
        lines = [shock for shock in shocks if shock.target == target]
        if lines:
            values[curve.rate.name] = _moved(curve, lines)
    for shock in shocks:
        if shock.target == PRICE:
            for i, each in enumerate(case.assets.classes):
                if shock.label in ("", each.name, each.kind):
                    price[i] *= 1 + shock.size
        elif shock.target not in CURVES:
            known = given[shock.target]
            now = values.get(shock.target, known.values).copy()
            chosen = np.array([shock.label in ("", label) for label in known.labels])
            now[chosen] = shock.of(now[chosen])
            values[shock.target] = now
    return Stressed(name, values, price)


def _moved(curve: Curve, lines: Sequence[Shock]) -> np.ndarray:
    """The quotes of a curve whose zero rates the lines move.

    "multiply" acts on annual rates, as the factors of regulators do; then "add", which on
    continuous ones is a shift of every forward rate too.
    """
    factors = [line for line in lines if line.kind == "multiply"]
    zero = zero_rates(curve)
    if factors:
        zero = np.log1p(_by_tenor(curve, factors, np.expm1(zero)))
    return from_zero_rates(curve, _by_tenor(curve, [s for s in lines if s.kind == "add"], zero))


def _by_tenor(curve: Curve, lines: Sequence[Shock], rates: np.ndarray) -> np.ndarray:
    """Rates [n] moved by lines of one kind: those without a tenor move all of them alike, those
    with one by sizes that are linear between tenors and constant outside."""
    for line in lines:
        if not line.label:
            rates = line.of(rates)
    known = sorted((float(line.label), line.size) for line in lines if line.label)
    if known:
        tenors, sizes = np.array(known).T
        rates = lines[0].of(rates, np.interp(curve.tenor, tenors, sizes))
    return rates


def stressed(
    case: PensionCase, before: dict[str, Any], scenario: Stressed, notional: np.ndarray
) -> dict[str, Any]:
    """Assets, liabilities and funding ratio at once after a shock, present holdings kept."""
    after = before | {
        name: np.asarray(values, np.float64) for name, values in scenario.values.items()
    }
    ratio = scenario.price * np.exp(_change(log_prices, case, before, after))
    assets = float(held_now(case) @ ratio)
    if case.overlay is not None:
        assets += float(notional @ _change(swap_values, case, before, after))
    liability = float(figures(case, after).liability)
    return {
        "scenario": scenario.scenario,
        "assets": assets,
        "liability": liability,
        "funding": assets / liability,
        "surplus": assets - liability,
    }


def _change(worth: Callable, case: PensionCase, before: dict, after: dict) -> np.ndarray:
    """Changes of `worth` from one set of inputs to another."""
    with jax.enable_x64(True):
        return np.asarray(worth(case, after)) - np.asarray(worth(case, before))
