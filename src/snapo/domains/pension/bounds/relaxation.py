"""The bound of a fund: its assets are valued at a deflator's prices.

With a price of risk p the deflator D is D(t+1) = D(t) exp(-p @ noise - p^2 / 2) / cash / m(t),
where m(t) is the maximum expected growth of a unit of deflated money within the limits of weights
and swaps. Then D A earns nothing on average under any policy, so

    E[u(F)] <= E[sup over F of u(F) - y D(T) L F] + y (A(0) + E[sum of deflated money received])

for every y > 0 and p (Haugh, Kogan and Wang, Operations Research 54, 2006). The liability L is the
minimum and the money received the maximum over all decisions. The bound is exact if indexation and
contributions do not depend on decisions, and wide if they do. Costs of trading are neglected.
Assets must be above zero: leverage or payments can leave a debt, and with a debt D A could earn
money on average.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize_scalar

from snapo.engine import Rollout, Xla
from snapo.problem.noise import Draws, noise_of_steps
from snapo.problem.objective import ExpectedUtility, Mean, Objective
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.scenarios import EVALUATE, Pseudo, stream
from snapo.problem.smooth import Exact

from ..fund.books import MINIMUM, FundState, balance, opening
from ..fund.plan import contribution, indexation
from ..fund.schedule import FundTerms, Period
from ..fund.simulator import PensionSimulator
from ..market.dynamics import noise_size
from ..market.state import Market
from .best_mix import (
    ACROSS,
    GaussianReturns,
    Worth,
    best_mix,
    discounted_growth,
    fair,
    gaussian_returns,
    limits,
)

PATHS, STREAM = 512, 258  # on which prices are fitted
SHARES = np.linspace(0, 1, 6)  # of the prices at which all investments are fair
FUNDED = 1e6  # a funding ratio above every limit of a plan


class Extremes(NamedTuple):
    """Extremes of one path: `received` [T]: the maximum of contributions minus payments, in money;
    `liability`: the minimum of the liability at the horizon."""

    received: Float[Array, " T"]
    liability: Float[Array, ""]


def extremes(
    simulator: PensionSimulator, terms: FundTerms, steps: Period, before: Market, after: Market
) -> Extremes:
    """The extremes of rights and contributions on a path; its markets `before` and `after` each
    step have leaves [T, …]. Decisions affect rights through indexation only, and contributions
    through assets and rights. The minimum rights follow from the smallest increase at every date,
    and the maximum rights from the largest increase. Contributions are highest without assets and
    with the maximum rights.
    """
    case = simulator.model

    def step(rights: tuple[FundState, FundState], values):
        now, market, then = values
        lower, maximum = (right._replace(market=market) for right in rights)
        received = _most_received(simulator, terms, now, lower, maximum)
        bounds = _increases(simulator, terms, now, market, then, lower.log_price_last)
        zero = jnp.zeros_like(bounds[0])
        lowest = simulator.rights(now, lower, then, bounds[0], zero)
        return (lowest, simulator.rights(now, maximum, then, bounds[1], zero)), received

    start = opening(terms)
    (minimum, _), received = jax.lax.scan(step, (start, start), (steps, before, after))
    last = balance(case, terms, terms.last, terms.last_shape, minimum)
    return Extremes(received, last.liability)


def _most_received(
    simulator, terms: FundTerms, now: Period, minimum: FundState, maximum: FundState
) -> Array:
    """The contributions of a fund without assets and with the maximum rights, minus the benefits of
    the minimum rights."""
    case = simulator.model
    books = balance(case, terms, now.people, now.shape, maximum)
    highest = contribution(
        case.plan,
        terms.plan,
        assets=jnp.zeros_like(terms.assets),
        liability=books.liability,
        normal_cost=books.accrual,
        payroll=now.people.payroll,
        wage=jnp.exp(maximum.market.log_wage),
        step=case.step,
        smooth=Exact(),
        annuity=now.annuity,
    )
    if now.agreed is not None:
        highest = highest + now.agreed
    alive = minimum.theta * jnp.exp(-minimum.deaths)
    benefit = alive * (now.people.benefit + minimum.fresh * now.people.fresh_benefit)
    return highest - benefit - now.people.expenses * jnp.exp(minimum.market.log_price)


def _increases(simulator, terms: FundTerms, now: Period, market: Market, then: Market, last: Array):
    """The smallest and the largest net increase at the end of the step, whatever the funding ratio
    is."""
    rule = simulator.model.plan.indexation
    if rule.kind == "none" and not rule.cut_years:
        return jnp.zeros_like(last), jnp.zeros_like(last)
    growth = jnp.expm1(then.log_price - last)
    poor, rich = (
        indexation(
            simulator.model.plan, terms.plan, ratio=ratio, price_growth=growth, smooth=Exact()
        )
        for ratio in (jnp.zeros_like(growth), jnp.full_like(growth, FUNDED))
    )
    minimum = jnp.minimum(poor[0], rich[0]) - poor[1]
    return now.due * minimum, now.due * jnp.maximum(poor[0], rich[0])


class FundPaths(NamedTuple):
    """The market on all paths, before prices of risk are applied: arrays are [T, N, …], those of
    bonds [T, …]."""

    returns: GaussianReturns
    noise: Float[Array, "T N Z"]


class Deflated(NamedTuple):
    """`over` [T, N]: D at the start of a step, divided by m; `after` [T, N]: D at its end;
    `growth`: the growth of a unit in each investment, before it is multiplied by D."""

    over: Array
    after: Array
    growth: Worth


class FundRelaxation:
    """See `snapo.Relaxation`. Prices of risk and y are fitted on separate paths. `policy` generates
    these paths, and its decisions have no effect on the fit.
    """

    terms, description = 1, "the innovations of the assets at fitted prices of risk"

    def __init__(self, problem: Problem, policy: Policy, paths: int = PATHS):
        simulator = problem.simulator
        assert isinstance(simulator, PensionSimulator)
        self.simulator, self.schedule = simulator, problem.schedule
        self.in_money = IN_MONEY in problem.objective.outputs
        fund = self.schedule.constants
        minimum = max(float(fund.liability), MINIMUM * float(fund.assets))
        self.conjugate = conjugate(problem.objective, float(fund.assets) / minimum)
        swaps = fund.swaps
        self.limits = limits(simulator.model, 0.0 if swaps is None else float(swaps.leverage))
        self._available, self._split, self._surprises = map(
            jax.jit, (self._on_paths, self._at_price, self._surprised)
        )
        self.price, self.y = self._fitted(problem, policy, paths)

    def best(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        if not scale.all():
            raise ValueError(
                "with perfect foresight and no penalty the value of a fund is "
                "unbounded: use --penalty value"
            )
        with jax.enable_x64(True):
            value, money = self._split(self.price, *self._available(rollout, draws))
            y = scale[0] * self.y
            return np.asarray(self.conjugate(y * value) + y * money)

    def charged(self, rollout: Rollout, draws: Draws, scale: np.ndarray) -> np.ndarray:
        with jax.enable_x64(True):
            return scale[0] * self.y * np.asarray(self._surprises(self.price, rollout, draws))

    def _fitted(self, problem: Problem, policy: Policy, paths: int) -> tuple[np.ndarray, float]:
        """The prices of risk [Z] of a step's normals, as the share of the fair ones at which the
        bound is lowest, and the y of this bound."""
        source = Pseudo(
            getattr(problem.sources.evaluation, "seed", 0), stream=stream(EVALUATE, STREAM)
        )
        (block,) = source.blocks(paths, 1)
        draws = source.draws(block, problem.simulator)
        engine = Xla(precision="float64").bind(problem)
        rollout = engine.values(policy, draws, Exact(), record=("state",))
        with jax.enable_x64(True):
            available = self._available(rollout, draws)
            price = fair(available[0].returns)
            minima = [self._lowest(*self._split(share * price, *available)) for share in SHARES]
        minimum = int(np.argmin([value for value, _ in minima]))
        return SHARES[minimum] * price, minima[minimum][1]

    def _lowest(self, value: Array, money: Array) -> tuple[float, float]:
        """The lowest bound over y, from the results of `_at_price`, and its y."""

        def upper_bound(log: float) -> float:
            return float(jnp.mean(self.conjugate(np.exp(log) * value) + np.exp(log) * money))

        result = minimize_scalar(upper_bound, (-3.0, 0.0))
        return float(result.fun), float(np.exp(result.x))

    def _on_paths(self, rollout: Rollout, draws: Draws) -> tuple[FundPaths, Extremes]:
        return self._paths(rollout, draws), self._extremes(rollout)

    def _paths(self, rollout: Rollout, draws: Draws) -> FundPaths:
        before = rollout.record["state"].market
        across = jax.vmap(gaussian_returns, (None, None, None, 0), ACROSS)
        terms, steps = self.schedule.constants, self.schedule.steps
        returns = jax.vmap(across, (None, None, 0, 0))(self.simulator.model, terms, steps, before)
        size = noise_size(self.simulator.model)
        return FundPaths(returns, noise_of_steps(draws, self.simulator.horizon, size))

    def _extremes(self, rollout: Rollout) -> Extremes:
        """[N, …] the minimum and the maximum over all decisions on these paths."""
        before = rollout.record["state"].market
        after = jax.tree.map(
            lambda a, b: jnp.concatenate([a[1:], b[None]]), before, rollout.state.market
        )
        item = jax.vmap(extremes, (None, None, None, 1, 1))
        return item(self.simulator, self.schedule.constants, self.schedule.steps, before, after)

    def _deflated(self, price: Any, paths: FundPaths) -> Deflated:
        case = self.simulator.model
        price = jnp.asarray(price)

        def step(returns: GaussianReturns, noise):
            units = discounted_growth(case, returns, price)
            upper = best_mix(self.limits, units.classes, units.swaps)
            log = -noise @ price - price @ price / 2
            # Minus the log return of cash.
            log = log + returns.mean[-1] + returns.load[-1] @ noise
            return units, upper, log - jnp.log(upper)

        units, maximum, log = jax.vmap(jax.vmap(step, (ACROSS, 0)))(paths.returns, paths.noise)
        after = jnp.exp(jnp.cumsum(log, axis=0))
        before = jnp.concatenate([jnp.ones_like(after[:1]), after[:-1]])
        return Deflated(before / maximum, after, units)

    def _at_price(self, price: Any, paths: FundPaths, bounds: Extremes) -> tuple[Array, Array]:
        """Two arrays [N], divided by the assets now: D L at the end (D if the objective is in
        money); and the assets now plus all money received, deflated."""
        result, assets = self._deflated(price, paths), self.schedule.constants.assets
        received = jnp.sum(self._counts(result) * bounds.received.T, axis=0)
        minimum = 1.0 if self.in_money else bounds.liability
        return result.after[-1] * minimum / assets, 1 + received / assets

    def _counts(self, result: Deflated) -> Array:
        """The deflators [T, N] of the money received in a step, at its start or at its end."""
        if self.simulator.model.plan.timing == "advance":
            ones = jnp.ones_like(result.after[:1])
            return jnp.concatenate([ones, result.after[:-1]])
        return result.over * result.growth.money

    def _surprised(self, price: Any, rollout: Rollout, draws: Draws) -> Array:
        """The sum [N] over the steps of D A after a step minus its mean before the step, under the
        policy, divided by the assets now."""
        paths = self._paths(rollout, draws)
        result = self._deflated(price, paths)
        simulator, constants = self.simulator, self.schedule.constants
        states, actions = rollout.record["state"], rollout.record["action"]

        def step(now, state, action, noise, units: Worth):
            done = simulator.happen(constants, now, state, action, noise, Exact())
            mean = (done.invested - done.held.cost) * jnp.sum(done.held.weights * units.classes)
            if done.held.notional is not None:
                mean = mean + jnp.sum(done.held.notional * units.swaps)
            if case.plan.timing != "advance":
                mean = mean + done.flows.net * units.money
            return done.after.assets, mean

        case = simulator.model
        across = jax.vmap(step, (None, 0, 0, 0, 0))
        after, mean = jax.vmap(across)(
            self.schedule.steps, states, actions, paths.noise, result.growth
        )
        return jnp.sum(result.after * after - result.over * mean, axis=0) / constants.assets


Conjugate = Callable[[Array], Array]


IN_MONEY = "assets"  # the output that is not a share of the liability


def conjugate(objective: Objective, start: float = 1.0) -> Conjugate:
    """The conjugate of the objective as a function of z > 0, for an objective that increases in
    the final assets. F >= 0 is the final funding ratio, or the final assets; `start` is the
    funding ratio now.

    **Raises:** `ValueError` for any other objective, with a list of the allowed ones.
    """
    if isinstance(objective, ExpectedUtility) and objective.output in ("funding_ratio", IN_MONEY):
        return _of_power(objective.utility)
    if isinstance(objective, Mean) and objective.output == "log_relative":
        return lambda z: -jnp.log(z * start) - 1
    if isinstance(objective, Mean) and objective.output == "surplus_ratio":
        return lambda z: jnp.maximum(-z, -1.0)
    raise ValueError(
        'a fund has an upper bound for a utility ("crra") of funding_ratio or assets, and for'
        " the mean of log_relative or of surplus_ratio"
    )


def _of_power(utility) -> Conjugate:
    def gained(z: Array) -> Array:
        # u'(F + w) = z; no ratio is below zero.
        best = jnp.maximum(z ** (-1 / utility.risk_aversion), utility.wealth)
        if utility.risk_aversion == 1:
            gained = jnp.log(best)
        else:
            gained = best ** (1 - utility.risk_aversion) / (1 - utility.risk_aversion)
        return gained - z * (best - utility.wealth)

    return gained
