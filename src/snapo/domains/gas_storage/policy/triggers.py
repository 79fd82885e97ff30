"""Decisions of a policy: trigger prices by day, and the decision of today by inventory.

In all price states here only the fastest factor differs from zero, so that a spot price determines
the state. Prices are undiscounted spot prices in currency per unit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact

from ..contract.schedule import StoreState
from ..contract.simulator import StorageSimulator, simulator_of
from .network import HEAD, Economics, StoragePolicy

ROUND = 256  # inventories and prices of one call
SPOTS = 241  # spot prices tried for a trigger


class Triggers(NamedTuple):
    """Gas is injected at a spot price below `injection`, and withdrawn above `withdrawal`; NaN if
    there is no such price within the range of `spots_around`."""

    injection: Float[np.ndarray, " n"]
    withdrawal: Float[np.ndarray, " n"]


class TriggerDecision(NamedTuple):
    """The volumes injected and withdrawn on a day at some inventories, each [n]."""

    injection: np.ndarray
    withdrawal: np.ndarray


def triggers(
    problem: Problem, policy: StoragePolicy, day: np.ndarray, inventory: np.ndarray
) -> Triggers:
    """The trigger prices at the inventories [n] on the days with these numbers [n]."""
    with jax.enable_x64(True):
        schedule = problem.schedule
        now = jax.tree.map(lambda leaf: np.asarray(leaf)[day], schedule.steps)
        spots = spots_around(problem, now.forward, np.linspace(-1.0, 1.0, SPOTS))
        stock = np.asarray(inventory, float)
        values = (simulator_of(problem), schedule.constants, policy, now, stock, spots)
        buying, selling = (np.asarray(gain) for gain in _gains(*values))
    return Triggers(
        _crossing(spots, buying, falling=True), _crossing(spots, selling, falling=False)
    )


def spots_around(problem: Problem, forward: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """[n, shares] spot prices around the forward prices [n], at shares from -1 to 1 of a range.
    This range is exp(-1) to exp(1) times the forward price, unless `PriceProcess.price_spread`
    gives another one."""
    simulator = simulator_of(problem)
    values = {name: item.value for name, item in problem.inputs_by_name.items()}
    spread = simulator.process.price_spread(simulator.curve.in_numpy(values), values)
    if spread is None:
        return np.exp(shares) * forward[:, None]
    return forward[:, None] + spread * shares


def decide(
    problem: Problem,
    policy: StoragePolicy,
    day: int,
    inventory: np.ndarray,
    spot: np.ndarray | None = None,
) -> TriggerDecision:
    """The decision on a day at each inventory [n] and spot price [n], by default the forward
    price."""
    with jax.enable_x64(True):
        schedule = problem.schedule
        now = jax.tree.map(lambda leaf: np.asarray(leaf)[day], schedule.steps)
        stock = np.asarray(inventory, float)
        count = len(stock)
        price = np.full(count, float(now.forward)) if spot is None else np.asarray(spot, float)
        # Made longer to a round number, so that few lengths are ever compiled.
        stock, price = (np.pad(x, (0, -count % ROUND), mode="edge") for x in (stock, price))
        values = (simulator_of(problem), schedule.constants, policy, now, stock, price)
        return TriggerDecision(*(np.asarray(x)[:count] for x in _decided(*values)))


@compiled_sooner
def _decided(
    simulator: StorageSimulator, constants, policy: StoragePolicy, now, inventories, spots
):
    def one(inventory, spot):
        price = simulator.process.state_at(constants.price, now.price, spot)
        state = StoreState(inventory, price)
        observed = simulator.observe(constants, now, state)
        action, noise = policy(observed, Exact()), jnp.zeros(simulator.noise_size)
        _, outputs = simulator.step(constants, now, state, action, noise, Exact())
        return outputs["injection"], outputs["withdrawal"]

    return jax.vmap(one)(inventories, spots)


@compiled_sooner
def _gains(simulator: StorageSimulator, constants, policy: StoragePolicy, now, inventories, spots):
    """The gains of the first unit injected and of the first unit withdrawn, each [n, SPOTS]."""

    def one(now, inventory, spot) -> tuple[Array, Array]:
        price = simulator.process.state_at(constants.price, now.price, spot)
        state = StoreState(inventory, price)
        observed = simulator.observe(constants, now, state)
        value, economics = policy.marginal_value(observed), Economics(*observed[:HEAD])
        return value.first_in - economics.buy, economics.sell - value.first_out

    return jax.vmap(jax.vmap(one, in_axes=(None, None, 0)))(now, inventories, spots)


def _crossing(spot: np.ndarray, gain: np.ndarray, falling: bool) -> np.ndarray:
    """The spot price at which the gain changes sign, by linear interpolation, for each row."""
    result = np.full(len(spot), np.nan)
    requested = -1 if falling else 1
    for row, (s, g) in enumerate(zip(spot, gain)):
        change = np.flatnonzero(np.sign(g[1:]) - np.sign(g[:-1]) == 2 * requested)
        if change.size:
            # The crossing nearest to the forward price.
            i = change[np.argmin(np.abs(change - len(s) // 2))]
            result[row] = s[i] - g[i] * (s[i + 1] - s[i]) / (g[i + 1] - g[i])
    return result
