"""The five parts of a contract that the core uses: levels, modes, moves, cash and names.

The feasible moves, the simulator of one path, the policy, the lattice, the fitted value and the
bound use only these parts. A contract is a module of inputs with one method, `terms`, and a static
`ContractLayout`. It may be in one of a few modes; on each step it makes one of the moves that begin
in its mode, and each flow of that move has a volume from an interval.

    levels after a step = levels + move.changes + effects[flow] volume
    earnings of a step  = move's money + move's index I + volume (price S + index I + money)
                          + money of the levels

S is the spot price. I is the index of an indexed contract: the index of a month, or the spot price
of a second commodity. Levels may be negative; the money of a level is linear on each side of zero
(`LevelMoney`).

All money is a present value. Limits hold after each step; a level that `restarts` is then
settled (`short` for each unit below `owed`) and set to zero, as at the end of a contract year.
"""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from snapo.case.given import CaseInput
from snapo.case.table import TableContext
from snapo.problem.record import AbstractVar, TreeRecord
from snapo.problem.record.arrays import Array, Bool, Float, NumbersOf

from ...gas_storage.prices.process import Delivery, PriceProcess
from .bank import Bank

ONLY = 0  # the mode of a contract that has one


class Level(NamedTuple):
    """A volume that a contract counts: its `name` in reports, and its `unit`."""

    name: str
    unit: str


class EnergyFlow(NamedTuple):
    """A volume that may move: its `name` and `unit`, and the effect of one unit on each level."""

    name: str
    unit: str
    effects: tuple[float, ...]


class ContractMove(NamedTuple):
    """A way through one step.

    - `name`: its name in reports; `before`, `after`: the modes.
    - `flows`: indices of the flows that may be above zero; a method that compares volumes uses at
      most one of them in a step.
    - `changes`: the changes of each level, for all flows.
    """

    name: str
    before: int
    after: int
    flows: tuple[int, ...]
    changes: tuple[float, ...]


class ContractLayout(NamedTuple):
    """The fixed properties of a contract, on which compiled code depends.

    - `indexed`: whether its cash depends on an index as well as on the spot price.
    - `banks`: how many of the last levels are volumes of the first level that are carried from one
      contract year to the next, ordered by age; see `bank.py`.
    - `reported`: names of the moves that a path counts.
    - `sums`: the weights of the levels in joint limits, see `Promises`.
    - `fixed_volumes`: whether each move fixes the volume of its flow (`StepTerms.fixed_volume`);
      such a flow has no effect on a level.
    """

    levels: tuple[Level, ...]
    flows: tuple[EnergyFlow, ...]
    modes: tuple[str, ...] = ("",)
    moves: tuple[ContractMove, ...] = ()
    indexed: bool = False
    banks: int = 0
    reported: tuple[str, ...] = ()
    sums: tuple[tuple[float, ...], ...] = ()
    fixed_volumes: bool = False

    def plain(self) -> tuple:
        """The layout as plain tuples, as it is saved in the file of a policy."""
        levels, flows, moves = (tuple(map(tuple, x)) for x in (self.levels, self.flows, self.moves))
        flags = self.indexed, self.banks, self.reported
        more = (self.sums, True) if self.fixed_volumes else (self.sums,) if self.sums else ()
        return levels, flows, self.modes, moves, *flags, *more

    @classmethod
    def of_plain(cls, parts: tuple) -> "ContractLayout":
        """The inverse of `plain`."""
        levels, flows, modes, moves, *flags = parts
        made = tuple(Level(*x) for x in levels), tuple(EnergyFlow(*x) for x in flows)
        return cls(*made, modes, tuple(ContractMove(*x) for x in moves), *flags)

    @property
    def every_move(self) -> tuple[ContractMove, ...]:
        """The moves; for a contract without moves, one move in which everything may flow."""
        none = (0.0,) * len(self.levels)
        everything = ContractMove("", ONLY, ONLY, tuple(range(len(self.flows))), none)
        return self.moves or (everything,)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The pair (move, flow) of every volume that a policy decides. A flow without effect on
        the levels has the same volume in all moves, and is listed with the first move only."""
        result: list[tuple[int, int]] = []
        for m, move in enumerate(self.every_move):
            decided = [flow for _, flow in result if not any(self.flows[flow].effects)]
            result += [(m, flow) for flow in move.flows if flow not in decided]
        return tuple(result)

    @property
    def places(self) -> tuple[tuple[int, ...], ...]:
        """[moves] for each move, the numbers of the pairs of its flows."""
        pairs = self.pairs
        flows = [flow for _, flow in pairs]
        return tuple(
            tuple(pairs.index((m, f)) if (m, f) in pairs else flows.index(f) for f in move.flows)
            for m, move in enumerate(self.every_move)
        )

    @property
    def choices(self) -> tuple[int, ...]:
        """The numbers of the moves in all modes that have more than one move."""
        before = [move.before for move in self.moves]
        return tuple(m for m, mode in enumerate(before) if before.count(mode) > 1)

    @property
    def decisions(self) -> tuple[tuple[int, ...], ...]:
        """The positions of each decision in an action. A decision is a share that no move fixes, or
        the choice of a move in a mode, with a weight for each of its moves."""
        before, count = [self.moves[m].before for m in self.choices], len(self.pairs)
        shares = () if self.fixed_volumes else tuple((i,) for i in range(count))
        return shares + tuple(
            tuple(count + k for k, mode in enumerate(before) if mode == one)
            for one in dict.fromkeys(before)
        )

    @property
    def signs(self) -> tuple[int, ...]:
        """[levels] 1, or -1 if a flow moves this level in the opposite direction to the first level
        that it moves."""
        signs = np.ones(len(self.levels), int)
        for flow in self.flows:
            touched = np.flatnonzero(flow.effects)
            if len(touched) > 1:
                first = signs[touched[0]] * np.sign(flow.effects[touched[0]])
                signs[touched] = first * np.sign(np.array(flow.effects)[touched])
        return tuple(map(int, signs))

    @property
    def flow_of(self) -> np.ndarray:
        """[flows, moves] 1 if the move has this flow, otherwise 0."""
        flows = range(len(self.flows))
        return np.array([[float(flow in move.flows) for move in self.every_move] for flow in flows])

    @property
    def effects(self) -> np.ndarray:
        """[flows, levels] the effect of a unit of each flow on each level."""
        return np.array([flow.effects for flow in self.flows])

    @property
    def changes(self) -> np.ndarray:
        """[moves, levels] the change of each level by each move."""
        return np.array([move.changes for move in self.every_move])


class Promises(NamedTuple):
    """Obligations that limit several levels together, or depend on the mode.

    After each step, in each mode, `weights` times the levels is at least `minimum`. A flow with an
    effect on the sum raises it.

    They ensure that every path meets a minimum `owed` when a level restarts. Methods that compare
    values charge a missed unit more than any unit costs. If there is `missed`, the sums of the
    layout are joint limits, which limit the flows that lower the sums. Methods then charge each
    unit missed after a step `missed` times more than any cost.
    """

    weights: Float[Array, "T promises levels"]
    minimum: Float[Array, "T promises modes"]
    missed: Float[Array, " T"] | None = None


class LevelMoney(NamedTuple):
    """Money that the levels earn: a step earns `after` for the levels after its move, minus
    `before` for the levels at its start. The last axis has the amount for each unit below zero, and
    for each unit above zero. If `after` and `before` are equal, the change of the level counts:
    each unit away from zero earns the amount, and each unit towards zero costs it.
    """

    before: Float[Array, "T levels 2"]
    after: Float[Array, "T levels 2"]


def level_money(rates: Array, levels: Any, positive: Callable) -> Any:
    """The money of levels. `rates`: the row [levels, 2] of a step in `before` or `after`; `levels`:
    one entry or array for each level."""
    parts = [
        rate[0] * positive(-level) + rate[1] * positive(level) for rate, level in zip(rates, levels)
    ]
    return sum(parts[1:], parts[0])


class MoveLimits(NamedTuple):
    """Limits of the levels after each move, which are equal to those of the step or narrower. A
    move whose `low` is above its `high` is not allowed in the step.

    The limits make the value jump between levels, so that methods need nodes on the limits, and
    must compare all volumes from node to node.
    """

    low: Float[Array, "T moves levels"]
    high: Float[Array, "T moves levels"]


class FallingLimit(NamedTuple):
    """The limit of the first level falls by `by` whenever the last level passes a multiple of
    `every`. It limits only flows that raise the first level. The value jumps at the multiples.
    """

    every: Float[Array, " T"]
    by: Float[Array, " T"]

    def falls(self, counted: Any, near: Any, xp: Any) -> Any:
        """How often the limit has fallen if the last level is `counted`. A level that is above a
        multiple by at most `near` has not passed it."""
        return xp.maximum(xp.ceil((counted - near) / self.every) - 1, 0.0)


class Intraday(NamedTuple):
    """Trades of differences from a schedule, in units of the market; see `intraday.py`.

    - `half_spread`: the cost of each unit of the difference; `discount`: the discount factor of
      this cost.
    - `sold`: units sold for each unit of a flow, negative if they are bought.
    """

    half_spread: Float[Array, " T"]
    discount: Float[Array, " T"]
    sold: Float[Array, "T flows"]


class StepTerms(NamedTuple):
    """The terms of every step: leaves [T, flows] or [T, levels].

    - `least`, `most`: the interval of a flow. `price`, `index`, `money`: a unit of the flow earns
      price x spot + index x the index + money; `index` is None if the contract has no index.
    - `low`, `high`: limits of the levels after the step.
    - `owed`, `short`: when a level restarts, `short` is lost for each unit below `owed`.
    - `restarts`: whether the level is set to zero after the step.
    - `fixed`: [T, moves] the amount that a move earns, and `fixed_index`: its multiple of the
      index, None if there is none. `fixed_volume`: the volume of the flow of a move, None if
      policies decide the volumes.
    - `promises`, `bank`, `of_levels`, `intraday`, `of_moves`, `falling`: None if the contract has
      none.
    """

    least: Float[Array, "T flows"]
    most: Float[Array, "T flows"]
    price: Float[Array, "T flows"]
    money: Float[Array, "T flows"]
    low: Float[Array, "T levels"]
    high: Float[Array, "T levels"]
    owed: Float[Array, "T levels"]
    short: Float[Array, "T levels"]
    restarts: Bool[Array, "T levels"]
    fixed: Float[Array, "T moves"]
    index: Float[Array, "T flows"] | None = None
    promises: Promises | None = None
    bank: Bank | None = None
    of_levels: LevelMoney | None = None
    fixed_index: Float[Array, "T moves"] | None = None
    fixed_volume: Float[Array, "T moves"] | None = None
    intraday: Intraday | None = None
    of_moves: MoveLimits | None = None
    falling: FallingLimit | None = None

    @property
    def jumps(self) -> bool:
        """Whether the value jumps between levels."""
        return self.of_moves is not None or self.falling is not None


class StepPrices(NamedTuple):
    """Prices of one step: the spot price, and the index if there is one."""

    spot: Any
    index: Any = None

    def unit(self, terms: StepTerms, place: Any) -> Any:
        """The earnings of a unit of a flow; `place`: its index in the leaves of `terms`."""
        cash = terms.price[place] * self.spot + terms.money[place]
        return cash if terms.index is None else cash + terms.index[place] * self.index

    def units(self, terms: StepTerms, t: int) -> np.ndarray:
        """[flows, columns] the earnings of a unit of every flow on step t, for the prices of each
        column."""
        return np.asarray(self.unit(terms, (t, slice(None), None)))

    def move(self, terms: StepTerms, row: Any) -> Any:
        """The earnings of a move, without those of its flows; `row`: its index in the leaves of
        `terms`."""
        money = terms.fixed[row]
        if terms.fixed_index is None:
            return money
        return money + terms.fixed_index[row] * self.index

    def moves(self, terms: StepTerms, t: int) -> np.ndarray:
        """[moves, columns] the earnings of every move on step t; [moves] if they do not depend on a
        price."""
        if terms.fixed_index is None:
            return np.asarray(terms.fixed[t])
        return np.asarray(self.move(terms, (t, slice(None), None)))


class Terms(NamedTuple):
    """The numbers of a contract: the levels at the `start` [levels], and the terms of its steps."""

    start: Float[Array, " levels"]
    steps: StepTerms


class EnergyContract(TreeRecord):
    """The agreed terms. After reading, the record has the numbers of the case; in a simulator it
    has no numbers."""

    layout: AbstractVar[ContractLayout]

    @abc.abstractmethod
    def terms(self, at: NumbersOf, paid: Array, settled: Array) -> Terms:
        """The terms of every step. `at`: returns the numbers of an input in the form in which they
        are used. `paid` [T]: discount factors of payments for the commodity; `settled` [T]:
        discount factors of amounts that are paid a day after the step.
        """

    @abc.abstractmethod
    def keys_at(self, levels: Mapping[str, float], mode: str, index: float | None) -> dict:
        """{key of `[contract]`: value} for a case that begins with these levels, {name: level}, in
        this mode; "a.b" is the key b in the table a. `index`: the index of the first step, if it
        was fixed before.

        **Raises:** `ValueError` if no case can begin in this way.
        """

    def check_together(self, file: str, days: Sequence[Any]) -> None:
        """Checks whether limits of several levels together can be met from the start; those of
        each level can. `days` [T]: dates of the steps.

        **Raises:** `CaseError` with the key that no decisions can meet.
        """

    @property
    def third_share(self) -> CaseInput | None:
        """How many units of a third commodity with a random price are needed for a unit of the
        second one; the index is then the cost of both. None without a third commodity."""
        return None

    def priced(self, where: TableContext, prices: PriceProcess, delivery: Delivery) -> PriceProcess:
        """The prices on which the cash flow depends, made from the prices of the case; by default
        these prices themselves. `where`: the table `[contract]`.

        **Raises:** `CaseError` if these prices are not supported.
        """
        return prices
