"""Schedules that are fixed at auctions, and trades of the differences from them.

At an auction the flows of all steps up to the next one are scheduled, at forward prices. In each
step the flows may still differ: the difference is sold at the spot price minus half a spread, or
bought at the spot price plus half a spread. With s the units sold by the schedule and m those sold
by the flows,

    earnings of a step = s F(auction, step) + (m - s) S - half spread x |m - s| + other money.

The schedule is feasible: its flows begin from the levels at the auction and keep all limits. Since
E[S | auction] = F, a schedule earns on average as much as sales at the spot price. Without a spread
the value is therefore equal to the value without auctions. With a spread it lies between that value
and the value of a schedule that is always kept.

The action has three shares of each volume: the share scheduled at the forward price, and the best
shares if the price of a unit is the spot price minus, or plus, a multiple of the half spread. The
flow is the scheduled volume, moved to the nearer of the other two volumes if it is not between
them.
"""

from dataclasses import fields, replace
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.form import formed
from snapo.problem.policy import as_observation
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import EXACT

from ...gas_storage.prices.factors import FactorPrices
from ...gas_storage.prices.process import PriceProcess
from .contract import ContractLayout, StepPrices
from .feasibility import volumes
from .observation import observation
from .policy import UnitValuePolicy
from .schedule import Constants, State, Step
from .simulator import EnergySimulator
from .tables import UnitValueTable, of_step

TRADED = "traded intraday"  # an output: units that differ from the schedule
GAIN = "schedule_gain"  # an output: money of the schedule over the spot price, of mean zero
VIEWS = 3  # the schedule; the spot price minus, and plus, half a spread
ONLY_MOVE = 0
# Half spreads by which a unit must gain before it is traded: one that is moved within a block pays
# two of them, one that is moved beyond it pays one.
GAINED = 1.5


class IntradaySimulator(EnergySimulator):
    """A contract with one move, its schedules and its trades.

    The first third of the observation depends only on the levels and prices at the last auction. A
    policy must compute the shares of the schedule from that third, as `IntradayPolicy` does. A
    policy that uses later prices for these shares earns too much; the mean of the output `GAIN` is
    then not zero.

    **Arguments:** those of `EnergySimulator`, and

    - `auction`: the prices at the auctions, `formed`.
    - `scheduled_values`: the fitted value of the contract that always keeps its schedules.
    """

    auction: PriceProcess | None = None
    scheduled_values: UnitValueTable | None = None

    @classmethod
    def bare(cls, case: Any) -> Self:
        made = super().bare(case)
        size = VIEWS * len(made.layout.pairs)
        return replace(made, auction=formed(case.scheduled), action=Box(0.0, 1.0, size))

    def on_paths(self):
        auction = jax.tree.map(lambda leaf: None, self.auction)
        return replace(super().on_paths(), auction=auction, scheduled_values=None)

    @property
    def _auctioned(self) -> FactorPrices:
        assert isinstance(self.auction, FactorPrices)
        return self.auction

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        schedule = super().prepare(inputs)
        prices, notice = self._auctioned.prepare(inputs), self._auctioned.delivery.notice
        assert notice is not None
        begins = (jnp.asarray(notice[: self.horizon]) == 0).at[0].set(True)
        rows = jax.tree.map(lambda leaf: leaf[: self.horizon], prices.steps)
        return Schedule(
            schedule.constants._replace(auction=prices.constants),
            schedule.steps._replace(auction=rows, begins=begins),
        )

    def prepared_apart(self):
        return replace(
            self, unit_values=None, surprises=None, scheduled_values=None
        ), self._completed

    def _completed(self, schedule: Schedule) -> Schedule:
        schedule, table = super()._completed(schedule), self.scheduled_values
        steps = schedule.steps._replace(scheduled_values=None if table is None else table.steps)
        return Schedule(schedule.constants, steps)

    def initial(self, constants: Constants, noise) -> State:
        state = super().initial(constants, noise)
        return state._replace(scheduled=state.levels, auction_price=state.price)

    def at_auction(self, now: Step, state: State) -> State:
        """The state for the schedule: the scheduled levels, and the prices at the last auction."""
        new = now.begins
        assert new is not None
        levels = jnp.where(new, state.levels, state.scheduled)
        price = jax.tree.map(lambda x, y: jnp.where(new, x, y), state.price, state.auction_price)
        return State(levels, state.mode, price)

    def observe(self, constants: Constants, now: Step, state: State) -> Float[Array, " features"]:
        assert now.terms.intraday is not None
        spot, free = self.prices(constants, now, state).spot, jnp.ones(1)
        plan, half = self.at_auction(now, state), now.terms.intraday.half_spread
        forward = self._auctioned.level(constants.auction, now.auction, plan.price)
        there = constants._replace(price=constants.auction)
        row = now._replace(price=now.auction, unit_values=now.scheduled_values)
        width = jnp.tanh(half / constants.price_scale)[None]

        def view(process, constants, row, at: State, price: Array) -> Array:
            gains = observation(self.layout, process, constants, row, at, StepPrices(price), free)
            # Zero for the schedule, which depends only on the levels and prices at its auction.
            off = (at.levels - plan.levels) / constants.volume_scale
            return jnp.concatenate([gains, off, width])

        result = [view(self._auctioned, there, row, plan, forward)]
        for price in (spot - GAINED * half, spot + GAINED * half):
            result.append(view(self.process, constants, now, state, price))
        return jnp.concatenate(result)

    def step(self, constants: Constants, now: Step, state: State, action, noise, smooth):
        layout, scale, terms = self.layout, constants.volume_scale, now.terms
        assert terms.intraday is not None
        plan = self.at_auction(now, state)
        shares = action.reshape((VIEWS, len(layout.pairs)))
        rooms = [volumes(layout, ONLY_MOVE, now, x.levels, smooth, scale) for x in (plan, state)]
        effects, flows = jnp.asarray(layout.effects), np.array(layout.every_move[ONLY_MOVE].flows)
        planned, low, high = (
            room.forced + share * (room.most - room.forced)
            for room, share in zip((rooms[0], rooms[1], rooms[1]), shares)
        )
        made = jnp.clip(planned, jnp.minimum(low, high), jnp.maximum(low, high))
        levels, scheduled = (
            x.levels + volume @ effects[flows] for x, volume in ((state, made), (plan, planned))
        )
        spot = self.prices(constants, now, state)
        forward = self._auctioned.level(constants.auction, now.auction, plan.price)
        trade = terms.intraday
        sold = trade.sold[flows] @ planned
        traded = trade.sold[flows] @ (made - planned)
        cash = made @ jnp.stack([spot.unit(terms, flow) for flow in flows])
        cost = trade.half_spread * smooth.absolute(traded, scale)
        gain = trade.discount * sold * (forward - spot.spot)
        cash = cash + gain - trade.discount * cost

        def settled(x: Array) -> Array:
            return jnp.where(terms.restarts, 0.0, x)

        after = State(
            settled(levels),
            state.mode,
            self.process.step(constants.price, now.price, state.price, noise),
            settled(scheduled),
            plan.price,
        )
        missed = smooth.positive_part(terms.owed - levels, scale)
        lost = jnp.sum(jnp.where(terms.restarts, terms.short * missed, 0.0))
        outputs = {"cash_flow": cash - lost, "shortfall": lost}
        outputs |= {layout.flows[flow].name: volume for flow, volume in zip(flows, made)}
        outputs[TRADED] = smooth.absolute(traded, scale)
        if now.surprise is not None:
            moved = self.process.gaussian(state.price)
            outputs["value_surprise"] = of_step(now.surprise, moved, state, after)
            outputs[GAIN] = jax.lax.stop_gradient(gain)
        return after, outputs

    def control_variates(self) -> tuple[str, ...]:
        names = super().control_variates()
        return (*names, GAIN) if names else names


class IntradayPolicy(UnitValuePolicy):
    """The same rule for the schedule and for both prices of a trade.

    The observation has the entries for these three views, one after the other.
    """

    def __init__(self, layout: ContractLayout, features: int, **settings: Any):
        super().__init__(layout, features // VIEWS, **settings)

    def __call__(self, observation, smooth=EXACT):
        views = as_observation(observation).reshape((VIEWS, -1))
        return jnp.concatenate([super(IntradayPolicy, self).__call__(x, smooth) for x in views])


def simulator_kind(case: Any) -> type[EnergySimulator]:
    """The simulator of a case."""
    return EnergySimulator if case.scheduled is None else IntradaySimulator


def without_trades(problem: Problem, scheduled: bool) -> Problem:
    """The contract without auctions, or (`scheduled`) one that always keeps its schedules.

    The exact value of the former is an upper bound, and that of the latter a lower bound, on the
    value with auctions and trades.
    """
    simulator = problem.simulator
    assert isinstance(simulator, IntradaySimulator)
    numbers = {x.name: getattr(simulator, x.name) for x in fields(EnergySimulator)}
    numbers |= {"unit_values": None, "surprises": None}
    numbers["action"] = Box(0.0, 1.0, len(simulator.layout.pairs))
    if scheduled:
        numbers["process"] = simulator.auction
    return replace(problem, simulator=EnergySimulator(**numbers), rebuild=None)
