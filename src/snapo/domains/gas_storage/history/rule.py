"""A rule that decides from spot prices, day by day, without seeing later prices.

A spot price is one number, but a model may have several factors. A Kalman filter computes the mean
of the factors conditional on all prices so far. Prices have no measurement error and are linear in
the factors, so that the gains of the filter depend on the model only.
"""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.case.error import CaseError
from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact

from ..contract.records import EndTerms, StorageCase
from ..contract.schedule import StoreState
from ..contract.simulator import StorageSimulator, simulator_of, volume_sold
from ..ladder.forwards import PathCurves
from ..policy.network import StoragePolicy
from ..read.case import read_case
from ..setup import bare_problem, factors, rebuilt

CURVE = "forward_curve"  # the input
RANK = 1e-9  # of the largest singular value: less is no effect of a factor on the curve
ROOM = 1e-10  # variance of the fast factor, for a first price that is not the forward price


class SpotFilter(NamedTuple):
    """`gain` [T, F]: the gain for the price of each day; `decay` [T, F]: the decay of the factors
    since the day before."""

    gain: np.ndarray
    decay: np.ndarray


@dataclass(frozen=True, eq=False)
class DatedRule:
    """A policy of a solution on a date, and its problem, which begins on the first day that the
    policy decides. `filter`: the filter of the price factors; without a filter, a spot price
    changes the fast factor only. `prices`: the curve of the date with its loadings on the factors.
    """

    case: StorageCase
    problem: Problem
    policy: StoragePolicy
    filter: SpotFilter | None
    prices: PathCurves | None = None

    def from_curve(self, t: int, before: np.ndarray, spot: float, curve: np.ndarray) -> np.ndarray:
        """[1, F] the factors on day `t` of the rule, from its spot price and its curve.

        `curve` [T + 1 - t]: the forward prices of the day and of all later days. The spot price is
        matched exactly, and the curve by least squares. If the fit is not unique, the factors
        nearest to `before` [1, F] are used.
        """
        assert self.prices is not None and self.filter is not None
        loading, variance = self.prices.loadings(t)
        forward = self.prices.forward[t:]
        model = self.prices.factors
        prices = np.append(spot, curve)
        around, more = np.append(forward[0], forward), np.append(variance[0], variance)
        if model.additive:
            noise = prices - around
        else:
            noise = np.log((prices + model.shift) / (around + model.shift)) + more / 2
        first = loading[0]
        state = self.filter.decay[t] * before[0]
        state = state + first * (noise[0] - first @ state) / (first @ first)
        others = np.linalg.svd(first[None])[2][1:].T
        change = np.linalg.lstsq(loading @ others, noise[1:] - loading @ state, RANK)[0]
        return (state + others @ change)[None]

    def initial_factors(self, count: int) -> np.ndarray:
        """[count, F] the factors before the price of the first day: zero."""
        size = 1 if self.filter is None else self.filter.gain.shape[1]
        return np.zeros((count, size))


class DayResult(NamedTuple):
    """[N] the inventory after a day, the volumes, and the cash flow, discounted with the factors of
    the `ledger`. `factors` [N, F]: the mean of the factors conditional on the prices up to the day.
    """

    inventory: np.ndarray
    injection: np.ndarray
    withdrawal: np.ndarray
    cash: np.ndarray
    factors: np.ndarray


def solved_on(
    file: Path,
    data: Mapping[str, Any],
    day: datetime.date | None,
    inventory: float | None,
    curve: np.ndarray | None,
    policy: StoragePolicy | None = None,
) -> DatedRule:
    """The rule of the fitted value of a case on a date, with the prices up to that date.

    - `day`, `inventory`: the valuation date, and the gas in store on it; None for those of the
      case.
    - `curve`: the forward price of each day that the case needs; None for the curve of the case.
    - `policy`: a policy that decides instead of the fitted value, but reads the fitted value of
      this problem.
    """
    tables = dict(data)
    if day is not None and inventory is not None:
        tables["market"] = dict(data["market"]) | {"valuation_date": day}
        contract = {key: x for key, x in data["contract"].items() if key != "first_decision"}
        tables["contract"] = contract | {"inventory": inventory}
    case = read_case(file, tables)
    if case.model.sources(0) is not None:
        message = (
            "a back-test needs price factors that can be computed from spot prices; supplied "
            "paths have none"
        )
        raise CaseError(str(file), "model.kind", case.model.kind, message)
    problem = bare_problem(case)
    if curve is not None:
        inputs: Any = dict(problem.inputs)
        inputs[CURVE] = replace(inputs[CURVE], value=curve)
        problem = replace(problem, inputs=inputs)
    problem = rebuilt(problem)
    if policy is None:
        policy = StoragePolicy(problem.features, key=jax.random.key(0)).value_rule
    spots, model, schedule = spot_filter(problem), factors(problem), problem.schedule
    if spots is None or model is None:
        return DatedRule(case, problem, policy, None)
    forward = np.append(schedule.steps.forward, schedule.constants.end_forward)
    return DatedRule(case, problem, policy, spots, PathCurves(model, forward, np.zeros(())))


def decided(
    rule: DatedRule,
    t: int,
    ledger: Problem,
    day: int,
    inventory: np.ndarray,
    before: np.ndarray,
    spot: np.ndarray,
    curve: np.ndarray | None = None,
) -> DayResult:
    """The decisions on day `t` of the rule, at inventories and spot prices [N]; this day is the day
    `day` of the `ledger`. `before` [N, F]: the factors of the day before. `curve` [T + 1 - t]: the
    curve of the day, which determines the factors if there are several; it is used for a single
    path only. The cash flow has the costs and discount factors of the exact simulator of `ledger`,
    and is paid at this spot price, whatever price the model has.
    """
    gain, prior = None, before
    if rule.filter is not None:
        gain, prior = rule.filter.gain[t], rule.filter.decay[t] * before
        if curve is not None and before.shape[1] > 1:
            gain, prior = np.zeros_like(gain), rule.from_curve(t, before, float(spot[0]), curve)
    with jax.enable_x64(True):
        parts = (*_row(rule.problem, t), *_row(ledger, day))
        result = _day(rule.policy, *parts, gain, inventory, prior, spot)
        return DayResult(*map(np.asarray, result))


def _row(problem: Problem, t: int) -> tuple[StorageSimulator, Any, Any]:
    """The simulator without the arrays of the contract, the constants, and the row of the schedule
    for a day."""
    simulator, schedule = simulator_of(problem), problem.schedule
    light = replace(simulator.on_paths(), day=np.zeros(1, np.int64), hedge=None)
    return light, schedule.constants, jax.tree.map(lambda leaf: np.asarray(leaf)[t], schedule.steps)


@compiled_sooner
def _day(policy, simulator, constants, now, booked, terms, row, gain, inventories, priors, spots):
    def one(inventory, prior, spot):
        price = simulator.process.state_at(constants.price, now.price, spot)
        if gain is not None:
            prior = price = prior + gain * jnp.sum(now.price.loading * (price - prior))
        state = StoreState(inventory, price)
        action = policy(simulator.observe(constants, now, state), Exact())
        at = StoreState(inventory, booked.process.state_at(terms.price, row.price, spot))
        noise = jnp.zeros(booked.noise_size)
        after, outputs = booked.step(terms, row, at, action, noise, Exact())
        flows = outputs["injection"], outputs["withdrawal"]
        cash = volume_sold(row, *flows) * (spot * row.gas_discount) - outputs["costs"]
        return after.inventory, *flows, cash, prior

    return jax.vmap(one)(inventories, priors, spots)


def end_money(ledger: Problem, inventory: np.ndarray, spot: np.ndarray) -> np.ndarray:
    """[N] the discounted value of the gas left, at spot prices of the end date."""
    simulator, constants = simulator_of(ledger), ledger.schedule.constants
    terms = EndTerms(constants.end_levels, constants.end_values, constants.end_fraction)
    with jax.enable_x64(True):
        rule = simulator.contract.at_end

        def one(level, price):
            return rule.end_value(terms, level, lambda: price) * constants.end_discount

        return np.asarray(jax.vmap(one)(jnp.asarray(inventory), jnp.asarray(spot)))


def drawn_spots(problem: Problem, count: int, seed: int) -> np.ndarray:
    """[T + 1, count] spot prices that the model draws, for each day and the end date."""
    simulator, schedule = simulator_of(problem), problem.schedule
    with jax.enable_x64(True):
        process = simulator.on_paths().process
        rows, terms = schedule.steps.price, schedule.constants
        first, later = jax.random.split(jax.random.key(seed))
        origin = jax.random.normal(first, (count, process.initial_noise_size))
        steps = jax.random.normal(later, (simulator.horizon, count, process.noise_size))
        return np.asarray(_spots(process, terms.price, rows, terms.end_price, origin, steps))


@compiled_sooner
def _spots(process, constants, rows, end, origin, steps):
    level = jax.vmap(process.level, (None, None, 0))
    move = jax.vmap(process.step, (None, None, 0, 0))

    def step(state, row):
        now, noise = row
        return move(constants, now, state, noise), level(constants, now, state)

    state = jax.vmap(process.initial, (None, 0))(constants, origin)
    state, spots = jax.lax.scan(step, state, (rows, steps))
    return jnp.concatenate([spots, level(constants, end, state)[None]])


class RuleCash(NamedTuple):
    """[N] the money of each path; `cash` [T, N] by day, discounted."""

    money: np.ndarray
    cash: np.ndarray


def followed(rule: DatedRule, spots: np.ndarray, inventory: float | None = None) -> RuleCash:
    """The results of the rule on supplied spot prices [T + 1, N], from its first day to the end."""
    problem = rule.problem
    start = float(problem.schedule.constants.inventory) if inventory is None else inventory
    level, rows = np.full(spots.shape[1], start), []
    state = rule.initial_factors(spots.shape[1])
    for t in range(len(spots) - 1):
        result = decided(rule, t, problem, t, level, state, spots[t])
        level, state = result.inventory, result.factors
        rows.append(result.cash)
    cash = np.array(rows)
    fixed = float(problem.schedule.constants.fixed_costs)
    return RuleCash(cash.sum(axis=0) + end_money(problem, level, spots[-1]) - fixed, cash)


def spot_filter(problem: Problem) -> SpotFilter | None:
    """The filter of a problem; None if prices have risks other than Gaussian factors."""
    model = factors(problem)
    if model is None or not model.exact or model.spikes is not None:
        return None
    size = model.decay.shape[1]
    covariance, gains = np.zeros((size, size)), []
    for loading, decay, shock in zip(model.loading, model.decay, model.shock):
        covariance = np.outer(decay, decay) * covariance + shock @ shock.T
        covariance[model.fast, model.fast] += ROOM
        along = covariance @ loading
        variance = float(loading @ along)
        gain = along / variance if variance > 0 else np.zeros(size)
        covariance = covariance - np.outer(gain, along)
        gains.append(gain)
    return SpotFilter(np.array(gains), np.asarray(model.decay))
