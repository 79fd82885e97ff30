"""Power plant: fuel is burnt for power by the hour; starts, hot and cold, and minimum times.

    earnings = sum over hours on of discount x (q S - (idle + rate q) (G + e c) - o q)
               - sum over starts of discount x (money + fuel (G + e c))

S is the price of power, G the price of the fuel, and q the power in an hour on, between two limits.
c is the price of an emission certificate, which may also be random, and e is the number of
certificates for a unit of fuel (`gas_storage/prices/trio.py`). A start belongs to the last class
whose hours off have passed. Modes are the hours off so far, up to those of the last class, and the
hours on so far, up to `min_up`; with a ramp the latter are combined with the power of the hour, see
`ramp.py`.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, NumbersOf
from snapo.problem.record.either import xp

from ..core.contract import (
    ContractLayout,
    ContractMove,
    EnergyContract,
    EnergyFlow,
    Level,
    StepTerms,
    Terms,
)
from .ramp import TOLERANCE, PowerSteps

POWER = 0  # the flow


class PlantContract(EnergyContract):
    """The terms of a plant.

    - `min_power`, `max_power`: MW while the plant is on. `idle`, `rate`: fuel for an hour in which
      the plant is on, and for a MWh of power.
    - `per_fuel`, `emission_price` [T], `other_cost` [T]: certificates for a unit of fuel, their
      price (None if the price is random and part of the index), and other costs of each MWh of
      power.
    - `start_money`, `start_fuel` [classes]: cost and fuel of a start; None if starts are free.
    - `classes` [moves]: the class of each move that is a start, else -1; `runs` [moves]: whether it
      is on.
    - `start_limit`: the largest number of starts; 0 without a limit.
    - `ramp`, `power_before`: the largest change in MW per hour, and MW in the hour before the first
      one; None without a ramp. `steps`: the possible powers with a ramp; `powers` [moves]: the
      power of each move.
    """

    min_power: CaseInput
    max_power: CaseInput
    idle: CaseInput
    rate: CaseInput
    per_fuel: CaseInput
    emission_price: CaseInput | None
    other_cost: CaseInput
    start_money: CaseInput | None
    start_fuel: CaseInput | None
    layout: ContractLayout = field(static=True)
    classes: tuple[int, ...] = field(static=True)
    runs: tuple[bool, ...] = field(static=True)
    start_limit: int = field(static=True)
    ramp: CaseInput | None = None
    power_before: CaseInput | None = None
    steps: PowerSteps | None = field(static=True, default=None)
    powers: tuple[int, ...] = field(static=True, default=())

    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        count, counted = len(paid), len(self.layout.levels)
        emissions = xp.zeros(count)
        if self.emission_price is not None:
            emissions = at(self.per_fuel) * at(self.emission_price)
        rate = at(self.rate)
        running = xp.asarray(self.runs, float)
        fuel, money = at(self.idle) * running, xp.zeros(len(self.classes))
        if self.start_money is not None and self.start_fuel is not None:
            starts, none = np.array(self.classes) >= 0, np.maximum(self.classes, 0)
            fuel = fuel + starts * at(self.start_fuel)[none]
            money = money + starts * at(self.start_money)[none]
        cost = rate * emissions + at(self.other_cost)
        fixed = -paid[:, None] * (money + fuel * emissions[:, None])
        none = xp.zeros((count, counted))
        steps = StepTerms(
            xp.full((count, 1), 1.0) * at(self.min_power),
            xp.full((count, 1), 1.0) * at(self.max_power),
            paid[:, None],
            -(cost * paid)[:, None],
            none,
            none + self.start_limit,
            none,
            none,
            xp.zeros((count, counted), bool),
            fixed,
            index=-(rate * paid)[:, None],
            fixed_index=-paid[:, None] * fuel,
        )
        return Terms(xp.zeros(counted), self._ramped(at, steps))

    def _ramped(self, at: NumbersOf, terms: StepTerms) -> StepTerms:
        """Adds the power of each move, if there is a ramp. The terms are NaN for inputs that would
        need other power steps than the contract has."""
        if self.ramp is None or self.steps is None:
            return terms
        limits = self.min_power, self.max_power, self.ramp, self.power_before
        numbers = [xp.zeros(()) if x is None else at(x) for x in limits]

        def combined(rows: Any) -> Array:
            columns = np.reshape(np.array(rows, float), (-1, len(numbers))).T
            total = xp.zeros(())
            for number, column in zip(numbers, columns):
                total = total + number * column
            return total

        valid = xp.all(combined(self.steps.conditions) >= -TOLERANCE * numbers[1])
        terms = terms._replace(fixed=xp.where(valid, terms.fixed, xp.nan))
        if not self.steps.steps:
            return terms
        every = combined([step.parts for step in self.steps.steps])
        powers = every[np.array(self.powers)] * xp.asarray(self.runs, float)
        return terms._replace(fixed_volume=xp.zeros_like(terms.fixed) + powers)

    @property
    def third_share(self) -> CaseInput | None:
        return self.per_fuel if self.emission_price is None else None

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        state, _, rest = mode.partition(" ")
        hours, _, name = rest.partition(", ")
        keys: dict = {"before": {state: int(hours)}}
        if name and self.steps is not None:
            limits = self.min_power, self.max_power, self.ramp, self.power_before
            numbers = [0.0 if x is None else float(x.values[0]) for x in limits]
            (parts,) = (step.parts for step in self.steps.steps if step.name == name)
            keys["before"]["power"] = float(np.dot(parts, numbers))
        if "starts" in levels:
            keys["most_starts"] = self.start_limit - round(levels["starts"])
        return keys


def layout_of(
    min_up: int,
    min_down: int,
    off: tuple[int, ...],
    first: tuple[bool, int],
    counted: bool,
    steps: PowerSteps | None = None,
) -> tuple[ContractLayout, tuple[int, ...], tuple[bool, ...], tuple[int, ...]]:
    """Modes and moves; for each move its class if it is a start (else -1), whether the plant is on,
    and the index of its power (0 if it is off or there is no ramp).

    - `off`: the hours off from which a class of starts applies; `counted`: whether starts count.
    - `first`: whether the plant is on before the first hour, and for how many hours.
    """
    longest = max(min_down, *off, 1)
    free = PowerSteps((), 0, (True,), ((0,),), ())  # any power follows any
    powers = steps if steps is not None and steps.steps else free
    suffixes = [f", {step.name}" for step in powers.steps] or [""]
    on, hours = first
    begins = (True, min(hours, min_up), powers.of_before) if on else (False, min(hours, longest), 0)
    running = _reachable(min_up, powers, begins)
    modes = [*running, *((False, k, 0) for k in range(1, longest + 1))]
    modes = [begins, *(mode for mode in modes if mode != begins)]
    where = {mode: i for i, mode in enumerate(modes)}
    none, one = (0.0,) * counted, (1.0,) * counted
    rows: list[tuple[ContractMove, int, bool, int]] = []

    def add(name: str, before: tuple, after: tuple, start: int = -1) -> None:
        changes = one if name == "start" else none
        flows = (POWER,) if after[0] else ()
        move = ContractMove(name, where[before], where[after], flows, changes)
        rows.append((move, start, after[0], after[2]))

    startable = [p for p, possible in enumerate(powers.at_ends) if possible]
    for k in range(1, longest + 1):
        add("stay off", (False, k, 0), (False, min(k + 1, longest), 0))
        if k >= min_down:
            kind = int(np.searchsorted(off, k, side="right")) - 1
            for p in startable:
                add("start", (False, k, 0), (True, 1, p), kind)
    for _, j, p in running:
        if j == min_up and p in startable:
            add("stop", (True, j, p), (False, 1, 0))
        for after in powers.next[p]:
            add("run", (True, j, p), (True, min(j + 1, min_up), after))
    levels = (Level("starts", "starts"),) if counted else ()
    power = EnergyFlow("power", "MW", (0.0,) * counted)
    every, classes, runs, of_moves = zip(*rows)
    names = tuple(f"{'on' if on else 'off'} {n}{suffixes[p] if on else ''}" for on, n, p in modes)
    layout = ContractLayout(
        levels,
        (power,),
        names,
        every,
        indexed=True,
        reported=("start",),
        fixed_volumes=powers is steps,
    )
    return layout, classes, runs, of_moves


def _reachable(min_up: int, powers: PowerSteps, begins: tuple) -> list[tuple[bool, int, int]]:
    """The modes in which the plant runs and that it can reach from a start or from its first
    mode."""
    reached = {(1, p) for p, possible in enumerate(powers.at_ends) if possible}
    if begins[0]:
        reached.add(begins[1:])
    for _ in range(min_up + len(powers.at_ends)):
        reached |= {(min(j + 1, min_up), q) for j, p in reached for q in powers.next[p]}
    every = product(range(1, min_up + 1), range(len(powers.at_ends)))
    return [(True, *mode) for mode in every if mode in reached]
