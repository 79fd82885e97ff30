"""Gamma by pair of products: second derivatives of the value with respect to forward prices.

    gamma[i, j] = d delta[i] / d F[j] = (delta[i](F + h e[j]) - delta[i](F - h e[j])) / 2h

The deltas are held derivatives (envelope theorem), each with the decisions that are best at its own
curve. With the same decisions on both sides cash would be linear in prices, and gamma would be
zero. Everything that is made from the inputs, such as the fitted value, is recomputed for every
moved curve; all deltas are on the same paths.

The size of the bump. A delta jumps on each path on which a decision changes. The share of such
paths is proportional to h, so that the standard error falls as 1 / sqrt(N h), while the bias grows
as h^2. For the gamma of an option at the money on a price with the standard deviation s, the mean
square error

    (s / 0.8 N h + (h / s)^4 / 36) gamma^2    is smallest at    h = s (11.25 / N)^(1/5),

where the bias is half of the standard error (P. Glasserman, Monte Carlo Methods in Financial
Engineering, Springer 2003, section 7.1). s is the standard deviation of the spot price of a product
around its mean, on each path, over the product and half a month on either side, because a common
change of all prices changes no decision.

A pair has two estimates, one from a bump of each product. With the best decisions both have the
same limit. Their mean is reported. Half of their difference, beyond its sampling error, is the
possible error of the policy.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from snapo.engine import TRAJECTORY, Engine
from snapo.problem.form import Use
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact
from snapo.solver.derivatives.by_block import DerivativePass
from snapo.solver.derivatives.rebuilt import problems_at
from snapo.solver.statistics import Estimate

from ..bounds.relaxation import spots_on_paths
from ..explain.curve import DeliveryPeriod

BALANCE = 11.25  # 9 / 0.8: of variance and bias, see above
BIAS = 0.5  # of the standard error, at that bump
AROUND = 15  # steps on either side of a product
SPREAD_PATHS, BLOCKS = 1024, 32


class PriceRise(NamedTuple):
    """A rise by 1 of the price of a product.

    - `dates`: first and last day of its delivery; `steps`: the steps of the simulator.
    - `numbers` [steps]: for each of these steps, the position of its forward price in the curve.
    - `along` [n]: the rise of the numbers of the curve; `price`: the mean forward price.
    """

    name: str
    dates: tuple[str, str]
    steps: slice
    numbers: np.ndarray
    along: np.ndarray
    price: float


def price_rises(
    periods: Sequence[DeliveryPeriod], days: Sequence[Any], curve: Use, values: np.ndarray
) -> list[PriceRise]:
    """The rises of one product for each period.

    `days`: the dates of the steps of the simulator; `curve`: the forward prices `values` [n] and
    where they are used on these steps.
    """
    name, size, rises = curve.name, len(values), []
    index = curve.in_numpy({name: np.arange(size)})
    prices = curve.in_numpy({name: values})
    for title, first, after in periods:
        along = np.zeros(size)
        dates = str(days[first])[:10], str(days[after - 1])[:10]
        steps = slice(first, after)
        along[index[steps]] = 1.0
        rises.append(
            PriceRise(title, dates, steps, index[steps], along, float(prices[steps].mean()))
        )
    return rises


class GammaMatrix(NamedTuple):
    """The matrix [n, n] of n products, as a present value, in units of volume per unit of price.

    - `both` [B, n, n]: the change of delta i for a bump of product j at [:, j, i], by block of
      paths.
    - `bumps` [n]: the bumps of the prices.
    """

    both: np.ndarray
    bumps: np.ndarray

    @property
    def symmetric(self) -> Estimate:
        """The mean of the two estimates of each pair."""
        return Estimate((self.both + self.both.transpose(0, 2, 1)) / 2)

    @property
    def standard_error(self) -> np.ndarray:
        """The standard error: the sampling error and the bias of the bump."""
        return np.hypot(1.0, BIAS) * self.symmetric.standard_error

    @property
    def policy(self) -> np.ndarray:
        """The possible error of the policy: half of the difference between the two estimates,
        beyond its standard error."""
        apart = Estimate(self.both - self.both.transpose(0, 2, 1))
        excess = apart.value**2 - apart.standard_error**2
        return np.sqrt(np.maximum(excess, 0.0)) / 2

    def along(self, prices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """[n] the matrix times prices [n], and its standard error. Without costs the product is
        zero if prices move in proportion to a curve that is flat within each product, since the
        value is then homogeneous of degree one."""
        product = Estimate(self.symmetric.blocks @ prices)
        return product.value, np.hypot(1.0, BIAS) * product.standard_error


def gamma_matrix(
    problem: Problem,
    policy: Policy,
    curve: str,
    rises: Sequence[PriceRise],
    prices: Schedule,
    engine: Engine,
    paths: int,
    progress: Callable[[str], None] = lambda text: None,
) -> GammaMatrix:
    """The gamma of the products, with two passes for each product.

    `curve`: the input of the forward prices; `prices`: the schedule of the price process. The
    forward prices of steps whose spot price is already fixed, such as that of the valuation date,
    are not moved: between kinks the value is linear in them.

    **Raises:** `ValueError` if the prices of a product are not random, since the value then has
    kinks in them.
    """
    source = problem.sources.evaluation
    blocks = source.blocks(source.available(paths), BLOCKS)
    count = sum(map(len, blocks))
    spots = centred_spots(problem, policy, prices, engine)
    spreads = price_spreads(spots, rises)
    if not np.all(spreads > 0):
        name = rises[int(np.argmin(spreads))].name
        raise ValueError(
            f"the price of {name} is not random: the value has kinks in it and no gamma"
        )
    bumps = spreads * (BALANCE / count) ** 0.2
    along, value = random_rises(spots, rises), problem.inputs_by_name[curve].value
    at_values, both = problems_at(problem), []
    for rise, by, bump in zip(rises, along, bumps, strict=True):
        sides = []
        for sign in (1.0, -1.0):
            shifted = at_values({curve: value + sign * bump * by.reshape(value.shape)})
            local = engine.bind(shifted, controls=False)
            path = DerivativePass(shifted, local, policy, Exact(), held=True)
            delta = path.derivatives(blocks).inputs[curve].blocks
            sides.append(delta.reshape(len(delta), -1) @ along.T)
        both.append((sides[0] - sides[1]) / (2 * bump))
        progress(f"gamma: {rise.name}, {len(both)} of {len(rises)}")
    return GammaMatrix(np.stack(both, axis=1), bumps)


def centred_spots(
    problem: Problem, policy: Policy, prices: Schedule, engine: Engine
) -> Float[np.ndarray, "T N"]:
    """The spot prices on some paths, minus their mean over the paths."""
    source, simulator = problem.sources.evaluation, problem.simulator
    draws = source.draws(np.arange(source.available(SPREAD_PATHS)), simulator)
    rollout = engine.bind(problem).values(policy, draws, Exact(), record=TRAJECTORY)
    process = getattr(simulator, "process")  # noqa: B009, of every kind of energy contract
    spots = spots_on_paths(process, prices, rollout)
    return spots - spots.mean(axis=1, keepdims=True)


def price_spreads(spots: Float[np.ndarray, "T N"], rises: Sequence[PriceRise]) -> np.ndarray:
    """[n] the standard deviation of the spot price around the mean of its path near each
    product."""
    spreads = []
    for rise in rises:
        first, after = max(rise.steps.start - AROUND, 0), rise.steps.stop + AROUND
        around = spots[first : min(after, len(spots))]
        spreads.append(np.sqrt(np.mean((around - around.mean(axis=0)) ** 2)))
    return np.array(spreads)


def random_rises(spots: Float[np.ndarray, "T N"], rises: Sequence[PriceRise]) -> np.ndarray:
    """[n, numbers of the curve] the rises, without the numbers on which no random spot price
    depends."""
    random = np.ptp(spots, axis=1) > 0
    moving = (np.isin(np.arange(x.along.size), x.numbers[random[x.steps]]) for x in rises)
    return np.stack([x.astype(float) for x in moving])
