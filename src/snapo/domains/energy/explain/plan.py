"""The steps between two valuation dates, as the policy plans them at forward prices."""

from dataclasses import fields, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import Exact

from ...gas_storage.contract.schedule import Discount
from ..core.contract import StepPrices
from ..core.policy import UnitValuePolicy
from ..core.simulator import EnergySimulator, simulator_of
from ..setup import OUTPUT

ROUNDED = 9  # decimals of a planned level: a limit is not passed by rounding


class PlannedSteps(NamedTuple):
    """The state after the steps, by name, and their cash, discounted to the later date."""

    levels: dict[str, float]
    mode: str
    cash: float


class AtForwardPrices(EnergySimulator):
    """A contract at today's forward prices, and at today's expectation of the index."""

    def prices(self, constants, now, state) -> StepPrices:
        if not self.layout.indexed:
            return StepPrices(now.forward)
        return StepPrices(now.forward, now.price.index.expected())


def planned_steps(
    problem: Problem, policy: UnitValuePolicy, count: int, elapsed: int
) -> PlannedSteps:
    """The first steps of a contract, one or more; `elapsed`: days to the later valuation date."""
    simulator = simulator_of(problem)
    numbers = {x.name: getattr(simulator, x.name) for x in fields(EnergySimulator)}
    numbers |= {name: _from_later(numbers[name], elapsed) for name in ("paid", "settled")}
    planned = AtForwardPrices(**numbers)
    with jax.enable_x64(True):
        inputs = {name: np.asarray(x.value) for name, x in problem.inputs_by_name.items()}
        schedule = jax.tree.map(np.asarray, _prepared(planned, inputs))
        rows = jax.tree.map(lambda leaf: leaf[:count], schedule.steps)
        light = replace(planned.on_paths(), time=np.zeros(1), first=0)
        levels, mode, cash = _planned(policy, light, schedule.constants, rows)
    layout = simulator.layout
    name = layout.modes[int(np.argmax(np.asarray(mode)))]
    return PlannedSteps(_named(layout, np.asarray(levels)), name, float(cash))


def state_of(problem: Problem) -> PlannedSteps:
    """The state in which a contract begins."""
    layout = simulator_of(problem).layout
    start = np.asarray(problem.schedule.constants.start)
    return PlannedSteps(_named(layout, start), layout.modes[0], 0.0)


def _named(layout: Any, levels: np.ndarray) -> dict[str, float]:
    numbers = [round(float(x), ROUNDED) + 0.0 for x in levels]
    return {level.name: x for level, x in zip(layout.levels, numbers, strict=True)}


def _from_later(discount: Discount, elapsed: int) -> Discount:
    """To a later date; a payment before it counts in full."""
    return replace(discount, day=np.maximum(discount.day - elapsed, 0.0))


@compiled_sooner
def _prepared(simulator: EnergySimulator, inputs: dict[str, Any]):
    return simulator.prepare(inputs)


@compiled_sooner
def _planned(policy, simulator: EnergySimulator, constants, rows):
    process = simulator.process
    noise = jnp.zeros(process.noise_size)

    def step(carry, now):
        state, cash = carry
        state = state._replace(price=process.state_at(constants.price, now.price, now.forward))
        action = policy(simulator.observe(constants, now, state), Exact())
        after, outputs = simulator.step(constants, now, state, action, noise, Exact())
        return (after, cash + outputs[OUTPUT]), None

    first = jax.tree.map(lambda leaf: leaf[0], rows)
    before = jnp.zeros(max(process.initial_noise_size, 1))
    state = simulator.initial(constants, before)
    state = state._replace(price=process.state_at(constants.price, first.price, first.forward))
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), state)
    (state, cash), _ = jax.lax.scan(step, (state, jnp.zeros(())), rows)
    return state.levels, state.mode, cash
