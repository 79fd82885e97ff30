"""The storage policy: its observation, a network that prices gas in store, and the flows.

The network corrects the marginal value of gas at the end of the day from the baseline, as a line in
the inventory. Gas is injected while its value in store exceeds its cost, and withdrawn while its
price exceeds its value in store: up to the inventory at which the value crosses the price, within
the feasible flows. This rule is exact for fast storage too, needs no further work for trigger
prices, and loses almost nothing under the exact rules.

The first `HEAD` numbers of the observation belong to the decision rule: the economics of today's
flows. The others are features of order one for the network. Prices are divided by the mean forward
price of the case, volumes by its largest daily rate.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.policy import (
    Network,
    Policy,
    as_observation,
    with_idle_network,
    without_idle_network,
)
from snapo.problem.smooth import EXACT

from ..prices.process import YEAR, PriceProcess


class Economics(NamedTuple):
    """Costs and values of today's flows; prices are in units of the mean forward price. `first_in`,
    `last_in`, `first_out` and `last_out` are the marginal values of gas at the end of the day from
    the table, valued on the day of the payment for gas: those of the first and the last unit of the
    largest injection, and of the largest withdrawal. If the value has a corner, the first unit
    injected has the slope above the corner, and the last unit the slope below it; for withdrawn
    units it is the opposite. `buy` is the cost of a unit injected, `sell` the proceeds of a unit
    withdrawn. `room_in` and `room_out` are the free flows in units of the largest rate, `level` the
    joint level of the slow price factors.
    """

    first_in: Array
    last_in: Array
    first_out: Array
    last_out: Array
    buy: Array
    sell: Array
    room_in: Array
    room_out: Array
    level: Array


HEAD = len(Economics._fields)


def economics(process: PriceProcess, terms, now, state, spot, flows) -> Economics:
    """The economics of a free flow on one day, in one state."""
    scale, discount = terms.price_scale, now.gas_discount
    level = process.slow_level(terms.price, now.price, state.price)
    keep = flows.keep + flows.base
    room_in, room_out = flows.maximum - flows.base, flows.base - flows.minimum
    if now.value_table is None:
        first_in = last_out = last_in = first_out = jnp.asarray(1.0)
    else:
        # The value table is data: it has no derivatives, and the adjoint need not form them.
        table, sides = (
            jax.lax.stop_gradient(now.value_table),
            ((keep, keep - room_out), (keep + room_in, keep)),
        )
        result = table.values(process, terms, now, state.price, *sides)
        first_in, last_out, last_in, first_out = (item / discount / scale for item in result)
    buy = spot * (1 + now.injection_fuel)
    buy += now.injection_cost * now.injection_cost_discount / discount
    sell = spot * (1 - now.withdrawal_fuel)
    sell -= now.withdrawal_cost * now.withdrawal_cost_discount / discount
    rate = terms.rate_scale
    values = (first_in, last_in, first_out, last_out)
    return Economics(*values, buy / scale, sell / scale, room_in / rate, room_out / rate, level)


def observation(process: PriceProcess, terms, now, state, spot, flows) -> Float[Array, " features"]:
    """The economics, followed by the features of the network."""
    observed = economics(process, terms, now, state, spot, flows)
    year = 2 * jnp.pi * now.day / YEAR
    left = (terms.last_day - now.day) / YEAR
    span = jnp.maximum(now.high - now.low, 1e-6 * terms.rate_scale)
    filling = (state.inventory - now.low) / span
    to_full = (now.high - state.inventory) / (20 * terms.rate_scale)
    to_empty = (state.inventory - now.low) / (20 * terms.rate_scale)
    mid = (observed.buy + observed.sell) / 2
    keep = (observed.first_in + observed.first_out) / 2
    features = [
        jnp.stack([jnp.sin(year), jnp.cos(year), jnp.sin(2 * year), jnp.cos(2 * year)]),
        jnp.stack([jnp.tanh(left), jnp.tanh(20 * left), 2 * filling - 1, filling * filling]),
        jnp.stack([jnp.tanh(to_full), jnp.tanh(to_empty)]),
        jnp.stack([jnp.tanh(5 * (v - mid)) for v in (keep, observed.last_in, observed.last_out)]),
        process.observe(terms.price, now.price, state.price),
        now.ahead,
    ]
    return jnp.concatenate([jnp.stack(observed), *features])


def curve_ahead(forward: Float[Array, " T"], scale) -> Float[Array, "T 5"]:
    """The later part of the curve relative to each day: the mean forward price of the next 30, the
    next 120 and all later days, the highest and the lowest, each minus the forward price of the
    day, in units of half the mean price."""
    t = forward.shape[0]
    first = np.minimum(np.arange(1, t + 1), t - 1)  # the last day has nothing ahead but itself
    # Running sums of a curve around zero, so that nothing is lost; memory grows with T only.
    middle = jnp.mean(forward)
    sums = jnp.append(0.0, jnp.cumsum(forward - middle))

    def mean(days):
        last = np.maximum(np.minimum(np.arange(t) + days + 1, t), first + 1)
        return middle + (sums[last] - sums[first]) / (last - first)

    def extremes(result, price):
        both = jnp.maximum(result[0], price), jnp.minimum(result[1], price)
        return both, both

    # By a loop: the derivative of a running maximum takes a thousand operations to compile.
    _, (high, low) = jax.lax.scan(extremes, (forward[-1], forward[-1]), forward, reverse=True)
    columns = [mean(30), mean(120), mean(t), high, low]
    return 2 * (jnp.stack(columns, axis=1) - forward[:, None]) / scale


CORRECTION = 0.1  # of the mean price: the network's numbers are of order one


class MarginalValue(NamedTuple):
    """The marginal values of gas at the end of the day, in units of the mean forward price: those
    of the first and the last unit of the largest injection, and of the largest withdrawal."""

    first_in: Array
    last_in: Array
    first_out: Array
    last_out: Array


class StoragePolicy(Policy):
    """The marginal value from the table plus a network; the action has the shares of the free
    injection and of the free withdrawal."""

    head: ClassVar[int] = HEAD  # numbers of the observation that the network does not see
    network: Network | None

    def __init__(
        self, features: int, *, key, hidden: tuple[int, ...] = (32, 32), activation=jax.nn.tanh
    ):
        self.network = Network((features - HEAD, *hidden, 3), key=key, activation=activation)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        return _flows(Economics(*observation[:HEAD]), self.marginal_value(observation), smooth)

    @property
    def value_rule(self) -> "StoragePolicy":
        """The policy of the value table only: its network adds nothing, so that the same compiled
        program runs both policies."""
        return with_idle_network(self)

    @property
    def simplest(self) -> "StoragePolicy":
        """The policy without its network, if the network adds nothing; otherwise the policy
        itself."""
        return without_idle_network(self)

    def marginal_value(self, observation) -> MarginalValue:
        """The value of a unit of gas at the end of the day under the policy."""
        economics = Economics(*observation[:HEAD])
        if self.network is None:
            return MarginalValue(*economics[:4])
        level, into, out = CORRECTION * economics.level * self.network(observation[HEAD:])
        return MarginalValue(
            economics.first_in + level,
            economics.last_in + level + into * economics.room_in,
            economics.first_out + level,
            economics.last_out + level + out * economics.room_out,
        )


def _flows(economics: Economics, value: MarginalValue, smooth):
    """The shares of the free injection and withdrawal that are profitable."""
    injected = smooth.share(value.first_in - economics.buy, value.last_in - economics.buy)
    withdrawn = smooth.share(economics.sell - value.first_out, economics.sell - value.last_out)
    return jnp.stack([injected, withdrawn])
