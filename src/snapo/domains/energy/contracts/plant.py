"""Power plant: fuel is burnt for power by the hour; starts, hot and cold, and minimum times.

    earnings = sum over hours on of discount x (q S - (idle + rate q) (G + e c) - o q)
               - sum over starts of discount x (money + fuel (G + e c))

S is the price of power, G that of the fuel, c that of emissions, e of which a unit of fuel needs; q
is the power of an hour on, between two limits. A start is of the last class whose hours off have
passed. Modes are the hours off so far, up to those of the last class, and the hours on so far, up
to `min_up`.
"""

from collections.abc import Mapping

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import field
from snapo.problem.record.arrays import Array, ArrayLibrary, NumbersOf

from ..core.contract import (
    ContractLayout,
    ContractMove,
    EnergyContract,
    EnergyFlow,
    Level,
    StepTerms,
    Terms,
)

POWER = 0  # the flow


class PlantContract(EnergyContract):
    """The terms of a plant.

    - `min_power`, `max_power`: MW on. `idle`, `rate`: fuel of an hour on, and for a MWh of power.
    - `per_fuel`, `emission_price` [T], `other_cost` [T]: emissions of a unit of fuel, their price,
      and other money for each MWh.
    - `start_money`, `start_fuel` [classes]: of a start; None where starts are free.
    - `classes` [moves]: the class of each move that is a start, else -1; `runs` [moves]: whether it
      is on.
    - `start_limit`: how many starts there may be; 0 without a limit.
    """

    min_power: CaseInput
    max_power: CaseInput
    idle: CaseInput
    rate: CaseInput
    per_fuel: CaseInput
    emission_price: CaseInput
    other_cost: CaseInput
    start_money: CaseInput | None
    start_fuel: CaseInput | None
    layout: ContractLayout = field(static=True)
    classes: tuple[int, ...] = field(static=True)
    runs: tuple[bool, ...] = field(static=True)
    start_limit: int = field(static=True)

    def terms(self, at: NumbersOf, paid: Array, settled: Array, arrays: ArrayLibrary) -> Terms:
        xp, count, counted = arrays.xp, len(paid), len(self.layout.levels)
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
        return Terms(xp.zeros(counted), steps)

    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        state, _, hours = mode.partition(" ")
        keys: dict = {"before": {state: int(hours)}}
        if "starts" in levels:
            keys["most_starts"] = self.start_limit - round(levels["starts"])
        return keys


def layout_of(
    min_up: int, min_down: int, off: tuple[int, ...], first: tuple[bool, int], counted: bool
) -> tuple[ContractLayout, tuple[int, ...], tuple[bool, ...]]:
    """Modes and moves, the class of each move that is a start (else -1), and whether it is on.

    - `off`: the hours off from which each class of starts holds; `counted`: whether starts are.
    - `first`: whether the plant is on before the first hour, and for how many hours.
    """
    longest = max(min_down, *off, 1)
    names = [f"on {j}" for j in range(1, min_up + 1)] + [f"off {k}" for k in range(1, longest + 1)]
    on, hours = first
    begins = f"on {min(hours, min_up)}" if on else f"off {min(hours, longest)}"
    names = [begins, *(name for name in names if name != begins)]
    where = names.index
    none, one = (0.0,) * counted, (1.0,) * counted
    rows: list[tuple[ContractMove, int, bool]] = []

    def add(name: str, before: str, after: str, start: int, runs: bool) -> None:
        changes = one if name == "start" else none
        flows = (POWER,) if runs else ()
        move = ContractMove(name, where(before), where(after), flows, changes)
        rows.append((move, start, runs))

    for k in range(1, longest + 1):
        add("stay off", f"off {k}", f"off {min(k + 1, longest)}", -1, False)
        if k >= min_down:
            add("start", f"off {k}", "on 1", int(np.searchsorted(off, k, side="right")) - 1, True)
    for j in range(1, min_up + 1):
        if j == min_up:
            add("stop", f"on {j}", "off 1", -1, False)
        add("run", f"on {j}", f"on {min(j + 1, min_up)}", -1, True)
    levels = (Level("starts", "starts"),) if counted else ()
    power = EnergyFlow("power", "MW", (0.0,) * counted)
    every, classes, runs = zip(*rows)
    layout = ContractLayout(
        levels, (power,), tuple(names), every, indexed=True, reported=("start",)
    )
    return layout, classes, runs
