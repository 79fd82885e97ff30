"""Reserve: capacity of a store that is sold by the step, or by the block of an auction.

    earnings of a step in reserve = discount x price x MW;  no flow,  low <= energy in store <= high

The MW are those that can be called either way: the smaller of what may be bought and of what may
be sold. Calls themselves are not modelled: on average they are taken to cancel, and to be paid for
apart. Prices of reserve are known today.

With blocks of several steps a block is in reserve from its first step to its last one: modes say
whether it is.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.csv import FileReference
from snapo.case.given import CaseInput
from snapo.case.plausible import Plausible
from snapo.case.quantity import NOT_NEGATIVE, KeyContext, custom
from snapo.case.table import CaseTable, TableContext
from snapo.problem.record import TreeRecord, field
from snapo.problem.record.arrays import Array, Bool, Float

from ..core.contract import ContractLayout, ContractMove, MoveLimits, StepTerms
from ..read.hours import HourlyQuantity, Hours, rows_by_hour

TRADE, RESERVE = "trade", "reserve"  # names of moves
MARKET, IN_RESERVE = 0, 1  # modes of a contract with blocks of several steps
MODES = "in the market", "in reserve"
STOCK = "two numbers of MWh, [1.0, 3.0]: 0 or more, the second not below the first"
PRICE = HourlyQuantity(
    "{currency}/MW/h", NOT_NEGATIVE, "reserve", move=1.0, by="time", column="price",
    name="reserve_price", meaning="for each MW sold as reserve for an hour",
    plausible=Plausible(0.01, 1000.0, "it is money for a MW and an hour, not for a block of hours"),
)  # fmt: skip


def _stock(raw: Any, key: KeyContext) -> np.ndarray:
    numbers = raw if isinstance(raw, list) else []
    valid = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    if not valid or len(numbers) != 2 or not 0 <= numbers[0] <= numbers[1] < np.inf:
        raise key.error(raw, f"it must be {STOCK}")
    return np.array(numbers, float)


class ReserveTable(CaseTable):
    """{ price = "reserve.csv", stock = [1.0, 3.0] }: an hour in which capacity is sold as reserve
    earns this for each MW. There is no flow in it, and the energy in store is within `stock`."""

    price: CaseInput | str = PRICE(PRICE.meaning)
    stock: np.ndarray = custom(_stock, STOCK, types=("array",))


class Reserve(TreeRecord):
    """The terms of reserve.

    - `price`: index [] or [T]; `stock` [2]: least and most energy in store.
    - `begins`, `ends` [T]: whether a step is the first, or the last one, of a block.
    """

    price: CaseInput
    stock: Float[np.ndarray, " 2"]
    begins: Bool[np.ndarray, " T"]
    ends: Bool[np.ndarray, " T"]
    moves: tuple[tuple[int, int], ...] = field(static=True)

    def added(self, terms: StepTerms, earned: Array, xp: Any) -> StepTerms:
        """Terms with the moves in reserve; `earned` [T]: by each of them."""
        fixed = xp.stack([xp.zeros_like(earned), *[earned] * len(self.moves)], axis=1)
        return terms._replace(fixed=fixed, of_moves=self._limits(terms.low.shape[1], xp))

    def _limits(self, levels: int, xp: Any) -> MoveLimits:
        """Of the first level, the energy in store; the other ones have none here."""
        begins, ends = xp.asarray(self.begins), xp.asarray(self.ends)
        free = xp.zeros(len(self.begins))
        low, high = [free - np.inf], [free + np.inf]
        for move in self.moves:
            # Within a block nothing flows, so that the limits of its first step hold on.
            stock = self.stock if move[0] == MARKET else (-np.inf, np.inf)
            possible = _possible(move, begins, ends)
            low.append(xp.where(possible, stock[0], np.inf))
            high.append(xp.where(possible, stock[1], -np.inf))
        rest = xp.zeros((len(self.begins), 1 + len(self.moves), levels - 1))
        both = (xp.stack(x, axis=1)[:, :, None] for x in (low, high))
        return MoveLimits(
            *(xp.concatenate([x, rest + y], axis=2) for x, y in zip(both, (-np.inf, np.inf)))
        )


def _possible(move: tuple[int, int], begins: Any, ends: Any) -> Any:
    """[T] whether a move in reserve between two modes may be made on a step: it is a block of one
    step, the first step of another block, one within it, or its last one. The last one is possible
    outside of blocks in reserve too, so that every mode has a move."""
    return {
        (MARKET, MARKET): begins & ends,
        (MARKET, IN_RESERVE): begins & ~ends,
        (IN_RESERVE, IN_RESERVE): ~begins & ~ends,
        (IN_RESERVE, MARKET): begins | ends,
    }[move]


def _moves(begins: np.ndarray, ends: np.ndarray) -> tuple[tuple[int, int], ...]:
    """The moves in reserve that some step has."""
    longer = bool(np.any(begins & ~ends))
    modes = (MARKET, IN_RESERVE) if longer else (MARKET,)
    every = ((before, after) for before in modes for after in modes)
    return tuple(move for move in every if _possible(move, begins, ends).any())


def with_reserve(layout: ContractLayout, reserve: Reserve | None) -> ContractLayout:
    """The layout with the moves and modes of reserve; the first move is without it."""
    if reserve is None:
        return layout
    still, flows = (0.0,) * len(layout.levels), tuple(range(len(layout.flows)))
    trade = ContractMove(TRADE, MARKET, MARKET, flows, still)
    moves = [ContractMove(RESERVE, before, after, (), still) for before, after in reserve.moves]
    modes = MODES if any(move != (MARKET, MARKET) for move in reserve.moves) else layout.modes
    return layout._replace(modes=modes, moves=(trade, *moves), reported=(RESERVE,))


def read_reserve(
    where: TableContext, raw: dict, hours: Hours, energy: float, currency: str
) -> Reserve:
    """The table `reserve` of a store of `energy` MWh; blocks are those of the auctions, or hours.

    **Raises:** `CaseError` where the store cannot hold the least energy, or a price is missing.
    """
    table = where.nested(ReserveTable, raw, RESERVE)
    low, high = (float(x) for x in table.stock)
    if high > energy:
        raise where.error("reserve.stock", [low, high], f"it must be within energy, {energy:g}")
    price = table.price
    if isinstance(price, str):
        section = TableContext(where.file, f"{where.name}.{RESERVE}", where.notes)
        rows = rows_by_hour(FileReference(section, "price", price), hours)
        price = PRICE.from_rows(PRICE.name, rows, hours.local)
    begins = np.ones(len(hours.days), bool)
    if hours.notice is not None:
        begins = np.array(hours.notice[: len(hours.days)]) == 0
        begins[0] = True
    ends = np.append(begins[1:], True)
    return Reserve(  # pyright: ignore[reportCallIssue]
        replace(price, unit=f"{currency}/MW/h"),
        table.stock,
        begins,
        ends,
        moves=_moves(begins, ends),  # pyright: ignore[reportCallIssue]
    )
