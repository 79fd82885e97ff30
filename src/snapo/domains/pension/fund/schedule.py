"""The numbers that all paths of a pension case share, computed from its inputs."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record import Schedule
from snapo.problem.record.arrays import Array, Float, jax
from snapo.problem.record.either import added, at_once, xp

from ..market.curve import log_bond
from ..market.dynamics import market_schedule
from ..market.state import MarketSteps, MarketTerms, without_empty
from ..people.liability import People, nodes, people
from ..people.lpi import limited, log_growth, lpi
from ..records.case import PensionModel, Scales
from ..records.inputs import use
from ..records.people import PAYMENT_YEARS
from .collateral import Stress, stress
from .plan import indexation_flags
from .terms import PlanTerms, TradingLimits, plan_terms, scales, trading_limits


class Swaps(NamedTuple):
    """The overlay. For each bucket [b]: the present `notional`, the limits `low` and `high`, the
    `cost`, and whether it is `at_par`. `leverage` is the limit of leverage; for `stress` see
    `collateral`. `nearest` [b, J] is 1 at the payment nodes that are nearer to the bucket than to
    others of its kind."""

    notional: Array
    low: Array
    high: Array
    cost: Array
    at_par: Array
    leverage: Array
    stress: Stress
    nearest: Array


class FundTerms(NamedTuple):
    """The numbers of the whole horizon. `assets`: the assets now (money); `weight`, `cost`, `fee`
    [n]: those of the classes; `last`, `last_shape` [J]: people and curve at the horizon;
    `liability`: its value now. `limits` and the `scales` of the features do not depend on inputs.
    """

    market: MarketTerms
    plan: PlanTerms
    assets: Array
    liability: Array
    weight: Array
    cost: Array
    fee: Array
    swaps: Swaps | None
    limits: TradingLimits
    scales: Scales
    last: People
    last_shape: Array


class Period(NamedTuple):
    """One step, the same for all paths: people at its start, the curve's `shape` [J] at the payment
    nodes, flags of indexation, `time` as a share of the horizon; `agreed`: the contributions agreed
    in money, None if there are none; `annuity`: that of `annuity`."""

    market: MarketSteps
    people: People
    shape: Array
    due: Array
    averaging: Array
    time: Array
    agreed: Array | None = None
    annuity: Array | None = None


def make_schedule(case: PensionModel, inputs: dict[str, Any]) -> Schedule:
    """All numbers that do not depend on the path."""
    payment_nodes = nodes(case.step)
    without_curve = None if case.scenarios is None else basis_log_bond(case, inputs, curve=False)
    result = people(case, inputs, basis_log_bond(case, inputs), without_curve)
    if limited(case):
        result = result._replace(lpi=lpi(case, inputs, payment_nodes))
    terms, steps, shape = market_schedule(case, inputs, payment_nodes)
    due, averaging = indexation_flags(case)
    assets = case.assets
    constants = FundTerms(
        market=terms,
        plan=plan_terms(case, inputs),
        assets=use(inputs, assets.amount),
        liability=xp.sum(result.accrued[0] * xp.exp(shape[0] - terms.slope @ terms.start.factors)),
        weight=use(inputs, assets.weight),
        cost=use(inputs, assets.cost),
        fee=use(inputs, assets.fee) * case.step,
        swaps=_swaps(case, inputs, payment_nodes),
        limits=trading_limits(assets, case.step),
        scales=jax.tree.map(xp.asarray, scales(case)),
        last=jax.tree.map(lambda leaf: leaf[-1], result),
        last_shape=shape[-1],
    )
    return Schedule(
        without_empty(constants),
        Period(
            market=without_empty(steps),
            people=jax.tree.map(lambda leaf: leaf[:-1], result),
            shape=shape[:-1],
            due=xp.asarray(due, float),
            averaging=xp.asarray(averaging, float),
            time=xp.arange(case.steps) / case.steps,
            agreed=agreed(case, inputs),
            annuity=annuity(case, inputs),
        ),
    )


def agreed(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " T"] | None:
    """The payments agreed in money, by step; None if there are none."""
    plan = case.plan.contribution.schedule
    if plan is None:
        return None
    return added(xp.zeros(case.steps), plan.step.copy(), use(inputs, plan.amount))


def _swaps(case: PensionModel, inputs: dict[str, Any], payment_nodes: np.ndarray) -> Swaps | None:
    overlay = case.overlay
    if overlay is None:
        return None
    nearest = np.zeros((case.buckets, len(payment_nodes)))
    first = case.buckets - overlay.inflation
    for kind in (slice(0, first), slice(first, case.buckets)):
        if kind.stop > kind.start:
            far = np.abs(payment_nodes - overlay.maturity[kind, None])
            nearest[kind] = np.arange(len(far))[:, None] == far.argmin(axis=0)
    return Swaps(
        notional=use(inputs, overlay.notional),
        # Copies: JAX remembers an array of the case in the type it met first, and policies hold it.
        low=xp.asarray(overlay.low.copy()),
        high=xp.asarray(overlay.high.copy()),
        cost=use(inputs, overlay.cost),
        at_par=xp.asarray(overlay.at_par),
        leverage=use(inputs, overlay.leverage),
        stress=stress(case, inputs, use(inputs, overlay.collateral_stress)),
        nearest=xp.asarray(nearest),
    )


def basis_log_bond(
    case: PensionModel, inputs: dict[str, Any], *, curve: bool = True
) -> Float[Array, " H"]:
    """ln of the discount factor at time 0 of a payment at time s * step, s = 0 ... H.

    H is `steps` plus the steps of `PAYMENT_YEARS`. The basis is that of `Liability`. Payments that
    follow prices are multiplied by the expected index; if increases have a cap and a floor, by the
    value of the options in them.

    **Arguments:** - `curve`: False leaves out the curve, for values that each path of ready-made
    scenarios discounts on a curve of its own.
    """
    basis, years = case.liability, payment_years(case)
    added = xp.zeros(len(years))
    if basis.basis != "risk-free":
        added = -added_rate(case, inputs, years) * years
    if limited(case):
        added = added + log_growth(case, inputs)
    if basis.basis == "fixed":
        return added
    result = added
    if curve:
        result = result + log_bond(case.curve, inputs, years)
    if basis.future_indexation == "full":
        result = result - log_bond(case.inflation.break_even, inputs, years)
    return result


def log_discount(case: PensionModel, inputs: dict[str, Any], years: np.ndarray) -> Array:
    """The logarithms [n] of the discount factors of money at times `years`, on the basis of the
    valuation."""
    basis, result = case.liability, xp.zeros(len(years))
    if basis.basis != "risk-free":
        result = -added_rate(case, inputs, years) * years
    if basis.basis != "fixed":
        return log_bond(case.curve, inputs, years) + result
    if basis.future_indexation == "full":  # a real rate
        result = result + log_bond(case.inflation.break_even, inputs, years)
    return result


def annuity(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " T"] | None:
    """The value at each step of 1 a year until the end of the recovery period, [T]; None without
    level payments (see `contributions`)."""
    period = case.plan.contribution.level_steps
    if period is None:
        return None
    now = np.arange(case.steps)
    end = now + period - now % period
    discount = xp.exp(log_discount(case, inputs, np.arange(end[-1] + 1) * case.step))
    paid = xp.concatenate([xp.zeros(1), xp.cumsum(discount)])
    first = 0 if case.plan.timing == "advance" else 1
    return case.step * (paid[end + first] - paid[now + first]) / discount[now]


def payment_years(case: PensionModel) -> np.ndarray:
    """The times of payments, in years."""
    return np.arange(case.steps + round(PAYMENT_YEARS / case.step) + 1) * case.step


def valued_years(case: PensionModel) -> np.ndarray:
    """The times of payments, and of the level payments of a longer recovery period, in years."""
    longest = max(round(PAYMENT_YEARS / case.step), case.plan.contribution.level_steps or 0)
    return np.arange(case.steps + longest + 1) * case.step


def added_rate(case: PensionModel, inputs: dict[str, Any], years: np.ndarray) -> Array:
    """The continuous rate that a basis adds to the curve when it discounts for `years`.

    An annual spread s on an annual zero rate i is ln(1 + s / (1 + i)). The rates are those of the
    case, which stay fixed if its curve moves.
    """
    basis, rate = case.liability, use(inputs, case.liability.rate)
    if not basis.annual:
        return rate * xp.ones(len(years))
    if basis.basis == "fixed":
        return xp.log1p(rate) * xp.ones(len(years))
    derived = case.derived
    if derived is None or derived.annual_bond is None:
        return xp.log1p(rate * xp.asarray(annual_bond(case, years)))
    return xp.log1p(rate * xp.asarray(derived.annual_bond[: len(years)]))


def annual_bond(case: PensionModel, years: np.ndarray) -> np.ndarray:
    """1 / (1 + annual zero rate) of the case's own curve, at each of `years`."""
    when = np.maximum(years, case.step)  # a payment now needs no rate
    return np.exp(np.asarray(at_once(log_bond)(case.curve, {}, when)) / when)
