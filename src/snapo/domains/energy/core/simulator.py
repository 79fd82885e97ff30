"""One path of any contract: prices, feasible volumes, cash.

The action has a share for each volume that may flow (`ContractLayout.pairs`): the share of the
feasible volume beyond the forced volume. If there is a choice of moves, it also has a weight for
each of these moves. In training moves may be mixed: levels, modes and cash are then means over
them.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.actions import Box
from snapo.problem.form import Use, formed
from snapo.problem.problem import Problem
from snapo.problem.record.either import with_numpy
from snapo.problem.simulator import Schedule
from snapo.problem.smooth import Exact

from ...gas_storage.contract.schedule import Discount, PricedSimulator
from ...gas_storage.policy.network import curve_ahead
from ...gas_storage.prices.process import PriceProcess, TwoPrices, in_numpy, use
from .contract import ContractLayout, EnergyContract, StepPrices, level_money
from .feasibility import charged, intervals, of_fixed_moves, volumes_by_move
from .observation import observation
from .schedule import Constants, State, Step
from .tables import Surprises, UnitValueTable, at_end, of_step

NEAR = 1e-6  # of the largest volume: rounding does not close a move


class SharesAndMoves(Box):
    """The action of a contract: the weights of the moves of a mode are one decision."""

    decisions: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __init__(self, layout: ContractLayout):
        super().__init__(0.0, 1.0, len(layout.pairs) + len(layout.choices))
        self.decisions = layout.decisions

    def together(self) -> list[list[int]]:
        return [list(numbers) for numbers in self.decisions]


class EnergySimulator(PricedSimulator):
    """A contract and its prices.

    **Arguments:**

    - `contract`, `process`: the contract and the price process of the case, after `formed`;
      `curve`, `rate`: the inputs of its forward prices and interest rates, and where they are used.
    - `paid`, `settled`: the discount factors of every step, for payments for the commodity, and for
      amounts paid a day after the step.
    - `time` [T]: years from the valuation date; `first`: the first step in the calendar.
    - `unit_values`: the fitted value that the policy starts from; `surprises`: the control variate.
    - `price_scale`, `volume_scale`: the mean size of the forward price, and the largest volume of a
      step.
    """

    contract: EnergyContract
    process: PriceProcess
    curve: Use
    rate: Use
    paid: Discount
    settled: Discount
    time: Float[np.ndarray, " T"]
    price_scale: Float[np.ndarray, ""]
    volume_scale: Float[np.ndarray, ""]
    unit_values: UnitValueTable | None = None
    surprises: Surprises | None = None
    layout: ContractLayout = eqx.field(static=True, default=ContractLayout((), ()))
    first: int = eqx.field(static=True, default=0)
    action: Box = eqx.field(static=True, default=Box(0.0, 1.0, 1))
    fully_observed = True

    @classmethod
    def of(cls, case: Any) -> Self:
        """The simulator of a case, with the scales of its numbers."""
        return cls.bare(case).scaled({x.name: x.values for x in case.numbers()})

    @classmethod
    def bare(cls, case: Any) -> Self:
        """The simulator of a case; all scales are 1."""
        layout, market = case.contract.layout, case.market
        return cls(  # pyright: ignore[reportCallIssue]
            formed(case.contract),
            formed(case.model),
            market.forward_curve.use(),
            market.zero_rate.use(),
            Discount.of(market.gas_day, market.zero_rate_day),
            Discount.of(case.day + 1, market.zero_rate_day),
            case.time,
            np.ones(()),
            np.ones(()),
            layout=layout,
            first=int(case.first_step),
            action=SharesAndMoves(layout),  # pyright: ignore[reportCallIssue]
        )

    def scaled(self, values: Mapping[str, np.ndarray]) -> Self:
        """The simulator with the scales of features for the values of these inputs."""
        # No volume depends on factors of discount.
        undiscounted: Any = np.ones(self.horizon)
        terms_of, at = with_numpy(self.contract.terms), partial(in_numpy, values)
        steps = terms_of(at, undiscounted, undiscounted).steps
        size = self.process.price_scale(self.curve.in_numpy(values), values)
        return replace(
            self,
            price_scale=np.asarray(size or 1.0),
            volume_scale=np.asarray(float(np.max(steps.most, initial=0.0)) or 1.0),
        )

    def on_paths(self):
        names = (
            "contract", "process", "curve", "rate", "paid", "settled", "unit_values", "surprises",
        )  # fmt: skip
        bare = jax.tree.map(lambda leaf: None, [getattr(self, name) for name in names])
        return replace(self, **dict(zip(names, bare)))

    def on_step(self):
        return replace(super().on_step(), time=None, first=0)

    @property
    def horizon(self) -> int:
        return len(self.time)

    @property
    def first_step(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.first

    def prepare(self, inputs: dict[str, Any]) -> Schedule:
        prices = self.process.prepare(inputs)
        rates, at = use(inputs, self.rate), partial(use, inputs)
        terms = self.contract.terms(at, self.paid(rates), self.settled(rates))
        forward = use(inputs, self.curve)[: self.horizon]
        terms = terms._replace(steps=charged(terms.steps, forward))
        steps = Step(
            jnp.asarray(self.time),
            forward,
            terms.steps,
            intervals(self.layout, terms.steps),
            jax.tree.map(lambda leaf: leaf[: self.horizon], prices.steps),
            curve_ahead(forward, self.price_scale),
        )
        constants = Constants(
            terms.start,
            prices.constants,
            jnp.asarray(self.price_scale),
            jnp.asarray(self.volume_scale),
            jnp.asarray(self.time[-1] if self.horizon else 0.0),
        )
        return self._completed(Schedule(constants, steps))

    def prepared_apart(self):
        return replace(self, unit_values=None, surprises=None), self._completed

    def _completed(self, schedule: Schedule) -> Schedule:
        """The schedule with the tables of the fitted value added, which do not depend on inputs
        here."""
        unit_values, surprises = self.unit_values, self.surprises
        steps = schedule.steps._replace(
            unit_values=None if unit_values is None else unit_values.steps,
            surprise=None if surprises is None else surprises.steps,
        )
        first = None if surprises is None else surprises.first
        return Schedule(schedule.constants._replace(first_value=first), steps)

    def initial(self, constants: Constants, noise) -> State:
        mode = jnp.zeros(len(self.layout.modes)).at[0].set(1.0)
        return State(constants.start, mode, self.process.initial(constants.price, noise))

    def prices(self, constants: Constants, now: Step, state: State) -> StepPrices:
        """The prices of the step."""
        spot = self.process.level(constants.price, now.price, state.price)
        if not self.layout.indexed:
            return StepPrices(spot)
        assert isinstance(self.process, TwoPrices)
        return StepPrices(spot, self.process.index(constants.price, now.price, state.price))

    def open_moves(self, now: Step, state: State, scale: Any) -> Float[Array, " moves"]:
        """1 for each move to levels from which the contract can be met, otherwise 0."""
        if len(self.layout.every_move) == 1 or not self.layout.levels:
            return jnp.ones(len(self.layout.every_move))
        near, result = NEAR * scale, []
        if self.layout.fixed_volumes:  # no flow changes a level
            after = state.levels + jnp.asarray(self.layout.changes)
            within = (after >= now.intervals.next_low - near) & (
                after <= now.intervals.next_high + near
            )
            return jnp.all(within, axis=1) * 1.0
        spaces = volumes_by_move(self.layout, now, state.levels, Exact(), scale)
        for i, (move, room) in enumerate(zip(self.layout.every_move, spaces)):
            after = state.levels + jnp.asarray(move.changes)
            for k, flow in enumerate(move.flows):
                assert room is not None
                after = after + room.forced[k] * jnp.asarray(self.layout.flows[flow].effects)
            within = (after >= now.intervals.next_low - near) & (
                after <= now.intervals.next_high + near
            )
            if now.terms.of_moves is not None:
                limits = now.terms.of_moves
                within &= (after >= limits.low[i] - near) & (after <= limits.high[i] + near)
            if now.terms.promises is not None:
                promises = now.terms.promises
                room = promises.weights @ after - promises.minimum[:, move.after]
                within = jnp.all(within) & jnp.all(room >= -near)
            result.append(jnp.all(within) * 1.0)
        return jnp.stack(result)

    def observe(self, constants: Constants, now: Step, state: State) -> Float[Array, " features"]:
        prices = self.prices(constants, now, state)
        free = self.open_moves(now, state, constants.volume_scale)
        return observation(self.layout, self.process, constants, now, state, prices, free)

    def step(self, constants: Constants, now: Step, state: State, action, noise, smooth):
        layout, scale = self.layout, constants.volume_scale
        prices, terms = self.prices(constants, now, state), now.terms
        weights = self._weights(constants, now, state, action)
        levels = jnp.zeros_like(state.levels)
        cash, flows = jnp.zeros(()), [jnp.zeros(()) for _ in layout.flows]

        def positive(x):
            return smooth.positive_part(x, scale)

        places, spaces = layout.places, []
        if layout.fixed_volumes:
            earned, volumes = of_fixed_moves(layout, terms, prices)
            flows = [jnp.sum(weights * volume) for volume in volumes]
            levels = state.levels + jnp.sum(weights[:, None] * layout.changes, axis=0)
            cash = jnp.sum(weights * earned)
        else:
            spaces = volumes_by_move(layout, now, state.levels, smooth, scale)
        for i, (move, room) in enumerate(zip(layout.every_move, spaces)):
            after, earned = state.levels + jnp.asarray(move.changes), prices.move(terms, i)
            if room is not None:
                for k, flow in enumerate(move.flows):
                    volume = room.at(k, action[places[i][k]])
                    after = after + volume * jnp.asarray(layout.flows[flow].effects)
                    earned = earned + volume * prices.unit(terms, flow)
                    flows[flow] = flows[flow] + weights[i] * volume
            if terms.of_levels is not None:
                earned = earned + level_money(terms.of_levels.after, after, positive)
            levels = levels + weights[i] * after
            cash = cash + weights[i] * earned
        mode = self._modes(weights)
        owed, settled = terms.owed, jnp.where(terms.restarts, 0.0, levels)
        if terms.of_levels is not None:
            cash = cash - level_money(terms.of_levels.before, state.levels, positive)
        if terms.bank is not None:
            indices = range(-layout.banks, 0)
            used = [
                terms.bank.made_up(x[0], [x[i] for i in indices], positive)
                for x in (state.levels, levels)
            ]
            cash = cash + terms.bank.refund * (used[1] - used[0])
            balances = [levels[i] for i in indices]
            owed = owed.at[0].set(terms.bank.owed(balances, positive))
            for i, balance in zip(indices, terms.bank.settled(levels[0], balances, positive)):
                settled = settled.at[i].set(jnp.where(terms.restarts[0], balance, levels[i]))
        missed = smooth.positive_part(owed - levels, scale)
        # A promise is met: `short` is then for methods that compare values.
        short = terms.short if terms.promises is None else jnp.zeros_like(terms.short)
        lost = jnp.sum(jnp.where(terms.restarts, short * missed, 0.0))
        after = State(
            settled,
            mode,
            self.process.step(constants.price, now.price, state.price, noise),
        )
        outputs = {"cash_flow": cash - lost, "shortfall": lost}
        outputs |= {flow.name: volume for flow, volume in zip(layout.flows, flows)}
        if layout.sums:  # the joint flow is counted until the day is over
            outputs[layout.levels[-1].name] = levels[-1] - state.levels[-1]
        for name in layout.reported:
            made = [weights[i] for i, move in enumerate(layout.moves) if move.name == name]
            outputs[name] = sum(made, jnp.zeros(()))
        if now.surprise is not None:
            moved = self.process.gaussian(state.price)
            outputs["value_surprise"] = of_step(now.surprise, moved, state, after)
        weight = self.process.weight(state.price)
        return after, {name: weight * output for name, output in outputs.items()}

    def _weights(self, constants: Constants, now: Step, state: State, action) -> Array:
        """[moves] the weight of each move: the weight of its mode, times its weight in the
        action."""
        layout = self.layout
        if len(layout.every_move) == 1:
            return jnp.ones(1)
        free = self.open_moves(now, state, constants.volume_scale)
        choices, count = layout.choices, len(layout.choices)
        weights = jnp.append(action[len(layout.pairs) :], 1.0)  # of a move without others
        every = [choices.index(m) if m in choices else count for m in range(len(layout.moves))]
        weights = weights[np.array(every)] * free
        before = np.array([move.before for move in layout.every_move])
        order = np.argsort(before, kind="stable")
        result = []
        for mode in range(len(layout.modes)):
            places = order[before[order] == mode]
            wanted, possible = weights[places], free[places]
            # A policy that wants only closed moves gets the open ones.
            wanted = jnp.where(jnp.sum(wanted) > 0, wanted, possible)
            total = jnp.sum(wanted)
            result.append(state.mode[mode] * wanted / jnp.where(total > 0, total, 1.0))
        return jnp.concatenate(result)[np.argsort(order)]

    def _modes(self, weights: Array) -> Array:
        """[modes] the weight of each mode after moves of these weights."""
        after = np.array([move.after for move in self.layout.every_move])
        return jnp.stack([jnp.sum(weights[after == k]) for k in range(len(self.layout.modes))])

    def terminal(self, constants: Constants, state: State, smooth):
        if constants.first_value is None:
            return {}
        return {"value_surprise": at_end(constants.first_value)}

    def in_mean(self):
        return self.process.in_mean()

    def control_variates(self) -> tuple[str, ...]:
        return () if self.surprises is None else ("value_surprise",)

    def slack(self, constants: Constants, now: Step, state: State, outputs):
        result = {}
        for i, level in enumerate(self.layout.levels):
            low, high = now.intervals.next_low[i], now.intervals.next_high[i]
            share = jnp.where(now.terms.restarts[i], 0.0, 1.0)
            result[f"least {level.name}"] = jnp.where(share > 0, state.levels[i] - low, 0.0)
            result[f"most {level.name}"] = jnp.where(share > 0, high - state.levels[i], 0.0)
        if now.terms.promises is not None:
            promises, restarts = now.terms.promises, jnp.any(now.terms.restarts)
            minimum = promises.minimum @ state.mode
            for k in range(len(minimum)):
                room = promises.weights[k] @ state.levels - minimum[k]
                result[f"promise {k + 1}"] = jnp.where(restarts, 0.0, room)
        return result | {flow.name: outputs[flow.name] for flow in self.layout.flows}


def simulator_of(problem: Problem) -> EnergySimulator:
    """The simulator of an energy contract."""
    simulator = problem.simulator
    if not isinstance(simulator, EnergySimulator):
        raise TypeError(f"{type(simulator).__name__} is not an energy contract.")
    return simulator
