"""The fund after every scenario of its file of shocks, which moves inputs and prices."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.inputs import plain
from snapo.report.page import Block, Missing, Table, Text
from snapo.report.quantity import MINUS, decimals, number
from snapo.study.chapter import Chapter, Number
from snapo.study.study import StudyRun

from ..market.assets.asset_class import log_prices
from ..market.assets.swaps import swap_values
from ..market.smith_wilson import log_bond
from ..read.stress import CURVES, PRICE, Shock, read_shocks
from ..records.case import PensionCase
from ..records.inputs import every_given
from ..records.market import MarketCurve
from ..results.balance import held_now
from ..results.figures.reconcile import figures
from ..results.setup import case_of
from ..run import PensionRun, points
from .reconciliation import RECONCILIATION

ROUNDS = 8  # of Newton's method; the zero rates of swaps are nearly linear in their rates


def zero_rates(curve: MarketCurve) -> np.ndarray:
    """The continuous zero rates at the nodes [n], for any kind of quotes."""
    if curve.quote == "zero":
        return curve.rate.used()
    if curve.quote == "swap":
        with jax.enable_x64(True):
            return np.asarray(_of_swaps(curve, jnp.asarray(curve.rate.used())))
    return np.cumsum(curve.rate.used() * np.diff(curve.tenor, prepend=0.0)) / curve.tenor


def from_zero_rates(curve: MarketCurve, zero: np.ndarray) -> np.ndarray:
    """The quotes of these zero rates: the inverse of `zero_rates`."""
    if curve.quote == "zero":
        return zero
    if curve.quote == "swap":
        return _to_swaps(curve, zero)
    return np.diff(zero * curve.tenor, prepend=0.0) / np.diff(curve.tenor, prepend=0.0)


@partial(jax.jit, static_argnums=0)
def _of_swaps(curve: MarketCurve, rate: Array) -> Array:
    return -log_bond(curve, rate, jnp.asarray(curve.ultimate.used()), curve.tenor) / curve.tenor


@partial(jax.jit, static_argnums=0)
def _closer(curve: MarketCurve, rate: Array, zero: Array) -> Array:
    """The swap rates after a step of Newton's method."""
    missed = _of_swaps(curve, rate) - zero
    return rate - jnp.linalg.solve(jax.jacfwd(_of_swaps, 1)(curve, rate), missed)


def _to_swaps(curve: MarketCurve, zero: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        rate = jnp.asarray(curve.rate.used())
        for _ in range(ROUNDS):
            rate = _closer(curve, rate, jnp.asarray(zero))
        return np.asarray(rate)


@dataclass(frozen=True)
class StressedBalance:
    """Assets, liability, their ratio and difference immediately after a scenario."""

    scenario: str = ""
    assets: Number = np.nan
    liability: Number = np.nan
    funding: Number = np.nan
    surplus: Number = np.nan


def measure(run: StudyRun) -> tuple[StressedBalance, ...]:
    """The balance sheet immediately after each scenario of the file; none without a file."""
    case, inputs = case_of(run), plain(run.setup.problem.inputs)
    now = np.zeros(0) if case.overlay is None else case.overlay.notional.used()
    shocks = scenarios(case, read_shocks(case))
    return tuple(stressed(case, inputs, scenario, now) for scenario in shocks)


@dataclass(frozen=True)
class Stressed:
    """A case after one scenario: the numbers of the inputs that moved, and the price ratio of each
    class. `values`: {input: [n]}; `price`: [classes], without the losses of bonds due to rates and
    spreads.
    """

    scenario: str
    values: dict[str, np.ndarray]
    price: np.ndarray


def scenarios(case: PensionCase, shocks: Sequence[Shock]) -> list[Stressed]:
    """The scenarios in the order of the file."""
    names = dict.fromkeys(shock.scenario for shock in shocks)
    return [_scenario(case, name, [s for s in shocks if s.scenario == name]) for name in names]


def _scenario(case: PensionCase, name: str, shocks: Sequence[Shock]) -> Stressed:
    inputs = {item.name: item for item in every_given(case)}
    values: dict[str, np.ndarray] = {}
    price = np.ones(len(case.assets.classes))
    for target, curve in zip(CURVES, (case.curve, case.inflation.break_even)):
        lines = [shock for shock in shocks if shock.target == target]
        if lines:
            values[curve.rate.name] = _moved(curve, lines)
    for shock in shocks:
        if shock.target == PRICE:
            for i, class_ in enumerate(case.assets.classes):
                if shock.label in ("", class_.name, class_.kind):
                    price[i] *= 1 + shock.size
        elif shock.target not in CURVES:
            available = inputs[shock.target]
            now = values.get(shock.target, available.values).copy()
            selected = np.array([shock.label in ("", label) for label in available.labels])
            now[selected] = shock.of(now[selected])
            values[shock.target] = now
    return Stressed(name, values, price)


def _moved(curve: MarketCurve, lines: Sequence[Shock]) -> np.ndarray:
    """The quotes of a curve whose zero rates are changed by the lines.

    "multiply" acts first, on annual rates, as the factors of regulators do. Then "add" acts on
    continuous rates, where an equal shift of all zero rates is also a shift of all forward rates.
    """
    factors = [line for line in lines if line.kind == "multiply"]
    zero = zero_rates(curve)
    if factors:
        zero = np.log1p(_by_tenor(curve, factors, np.expm1(zero)))
    return from_zero_rates(curve, _by_tenor(curve, [s for s in lines if s.kind == "add"], zero))


def _by_tenor(curve: MarketCurve, lines: Sequence[Shock], rates: np.ndarray) -> np.ndarray:
    """Rates [n] moved by lines of one kind. Lines without a tenor move all rates equally; the sizes
    of lines with a tenor are linear between tenors and constant outside."""
    for line in lines:
        if not line.label:
            rates = line.of(rates)
    available = sorted((float(line.label), line.size) for line in lines if line.label)
    if available:
        tenors, sizes = np.array(available).T
        rates = lines[0].of(rates, np.interp(curve.tenor, tenors, sizes))
    return rates


def stressed(
    case: PensionCase, before: dict[str, Any], scenario: Stressed, notional: np.ndarray
) -> StressedBalance:
    """Assets, liabilities and funding ratio immediately after a shock, with present holdings."""
    after = before | {
        name: np.asarray(values, np.float64) for name, values in scenario.values.items()
    }
    ratio = scenario.price * np.exp(_change(log_prices, case, before, after))
    assets = float(held_now(case) @ ratio)
    if case.overlay is not None:
        assets += float(notional @ _change(swap_values, case, before, after))
    liability = float(figures(case, after).liability)
    surplus = assets - liability
    return StressedBalance(scenario.scenario, assets, liability, assets / liability, surplus)


def _change(value: Callable, case: PensionCase, before: dict, after: dict) -> np.ndarray:
    """Changes of `value` from one set of inputs to another."""
    with jax.enable_x64(True):
        return np.asarray(value(case, after)) - np.asarray(value(case, before))


def show(run: PensionRun, result: tuple[StressedBalance, ...]) -> Sequence[Block]:
    """The balance sheet of today and after each scenario."""
    if not result:
        return [Missing("The case names no file of shocks (`[stress] file`).")]
    today = RECONCILIATION.of(run)
    liability, now = (today.liability, today.funding or 0.0) if today else (0.0, 0.0)
    scale, unit = run.size(run.assets, liability)
    body = [("Today", *_balance(run.assets, liability, scale), points(now, 1), "")]
    for row in result:
        amounts = _balance(row.assets, row.liability, scale)
        change = points(row.funding - now, 1, True)
        body.append((_signed(row.scenario), *amounts, points(row.funding, 1), change))
    head = [("Scenario", ""), ("Assets", unit), ("Liability", unit), ("Surplus", unit)]
    head += [("Funding ratio", "%"), ("Change", "points")]
    caption = (
        "Assets, swaps and liability are fully revalued after an instantaneous shock, with "
        "unchanged holdings. Equity, property and other classes with a separate mean and "
        "volatility do not react to rates."
    )
    return [Table(head, body, "", 1, strong=frozenset([0])), Text(caption, caveat=True)]


def _signed(scenario: str) -> str:
    """The name of a scenario with a minus sign before its numbers and a multiplication sign."""
    text = re.sub(r"(?<![\w.])-(?=\d)", MINUS, scenario)
    return re.sub(r"(?<= )x(?= \d)", "×", text)


def _balance(assets: float, liability: float, scale: float) -> tuple[str, ...]:
    amounts = assets / scale, liability / scale
    digits = decimals(amounts, 4)  # a surplus is a small difference of two large numbers
    return tuple(number(x, digits) for x in (*amounts, amounts[0] - amounts[1]))


STRESS = Chapter(
    "stress", "Stress table", tuple[StressedBalance, ...], measure, show,
    needs=("reconciliation",), key="stresses",
)  # fmt: skip
