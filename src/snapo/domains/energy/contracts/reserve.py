"""Reserve: capacity of a store that is sold by the step, or by the block of an auction.

    earnings of a step in reserve = discount x price x MW;  no flow,  low <= energy in store <= high

The MW are those that can be called either way: the smaller of the powers that may be bought and
sold. Calls themselves are not modelled: it is assumed that they cancel on average and are paid
separately. Prices of reserve are known today.

A block of several steps is sold as a whole; a mode of the contract shows that the block is in
reserve.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from snapo.case.csv import FileReference
from snapo.case.plausible import Plausible
from snapo.case.quantity import NOT_NEGATIVE, CaseInput, KeyContext, custom
from snapo.case.table import CaseTable, TableContext
from snapo.problem.record import TreeRecord, field
from snapo.problem.record.arrays import Array, Bool, Float
from snapo.problem.record.either import xp

from ..core.contract import ContractLayout, ContractMove, MoveLimits, StepTerms
from ..read.hours import HourlyQuantity, Hours, rows_by_hour

TRADE, RESERVE = "trade", "reserve"  # names of moves
MARKET, IN_RESERVE = 0, 1  # modes of a contract with blocks of several steps
MODES = "in the market", "in reserve"
STOCK = "two numbers in MWh, 0 or more and the second not below the first, such as [1.0, 3.0]"
PRICE = HourlyQuantity(
    "{currency}/MW/h", NOT_NEGATIVE, "reserve", move=1.0, by="time", column="price",
    name="reserve_price", meaning="price of each MW sold as reserve for an hour",
    plausible=Plausible(0.01, 1000.0, "it is the price of one MW for one hour, not for a block "
        "of hours"),
)  # fmt: skip


def _stock(raw: Any, key: KeyContext) -> np.ndarray:
    numbers = raw if isinstance(raw, list) else []
    valid = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    if not valid or len(numbers) != 2 or not 0 <= numbers[0] <= numbers[1] < np.inf:
        raise key.error(raw, f"it must be {STOCK}")
    return np.array(numbers, float)


class ReserveTable(CaseTable):
    """{ price = "reserve.csv", stock = [1.0, 3.0] }: an hour in which capacity is sold as reserve
    earns this price for each MW. There is no flow in such an hour, and the energy in store is
    within `stock`."""

    price: CaseInput | str = PRICE(PRICE.meaning)
    stock: np.ndarray = custom(
        "energy in store within which reserve is sold, in MWh", _stock, STOCK, types=("array",)
    )


class SoldReserve(TreeRecord):
    """The terms of reserve.

    - `price`: index [] or [T]; `stock` [2]: minimum and maximum energy in store.
    - `first_steps`, `last_steps` [T]: whether a step is the first step of a block, and whether it
      is the last step.
    """

    price: CaseInput
    stock: Float[np.ndarray, " 2"]
    first_steps: Bool[np.ndarray, " T"]
    last_steps: Bool[np.ndarray, " T"]
    moves: tuple[tuple[int, int], ...] = field(static=True)

    def added(self, terms: StepTerms, earned: Array) -> StepTerms:
        """The terms with the moves in reserve added; `earned` [T]: the earnings of a step in
        reserve."""
        fixed = xp.stack([xp.zeros_like(earned), *[earned] * len(self.moves)], axis=1)
        return terms._replace(fixed=fixed, of_moves=self._limits(terms))

    def _limits(self, terms: StepTerms) -> MoveLimits:
        """Adds the limits of the first level, the energy in store; those of other levels do not
        change."""
        first_steps, last_steps = xp.asarray(self.first_steps), xp.asarray(self.last_steps)
        bottom, top = terms.low[:, 0], terms.high[:, 0]
        low, high = [bottom], [top]
        for move in self.moves:
            # Within a block nothing flows, so that the limits of its first step hold on.
            stock = self.stock if move[0] == MARKET else (bottom, top)
            possible = _possible(move, first_steps, last_steps)
            low.append(xp.where(possible, stock[0], top))
            high.append(xp.where(possible, stock[1], bottom))
        both = [xp.stack(x, axis=1)[:, :, None] for x in (low, high)]
        rest = [xp.repeat(x[:, None, 1:], len(low), axis=1) for x in (terms.low, terms.high)]
        return MoveLimits(*(xp.concatenate(x, axis=2) for x in zip(both, rest)))


def _possible(move: tuple[int, int], first_steps: Any, last_steps: Any) -> Any:
    """[T] whether a move in reserve between two modes may be made on a step: as the only step of a
    block, or as the first, an inner or the last step of a longer block. The move for a last step is
    also possible on first steps, so that every mode has a move."""
    return {
        (MARKET, MARKET): first_steps & last_steps,
        (MARKET, IN_RESERVE): first_steps & ~last_steps,
        (IN_RESERVE, IN_RESERVE): ~first_steps & ~last_steps,
        (IN_RESERVE, MARKET): first_steps | last_steps,
    }[move]


def _moves(first_steps: np.ndarray, last_steps: np.ndarray) -> tuple[tuple[int, int], ...]:
    """The moves in reserve that are possible on at least one step."""
    longer = bool(np.any(first_steps & ~last_steps))
    modes = (MARKET, IN_RESERVE) if longer else (MARKET,)
    every = ((before, after) for before in modes for after in modes)
    return tuple(move for move in every if _possible(move, first_steps, last_steps).any())


def with_reserve(layout: ContractLayout, reserve: SoldReserve | None) -> ContractLayout:
    """The layout with the moves and modes of reserve; the first move is the one without reserve."""
    if reserve is None:
        return layout
    still, flows = (0.0,) * len(layout.levels), tuple(range(len(layout.flows)))
    trade = ContractMove(TRADE, MARKET, MARKET, flows, still)
    moves = [ContractMove(RESERVE, before, after, (), still) for before, after in reserve.moves]
    modes = MODES if any(move != (MARKET, MARKET) for move in reserve.moves) else layout.modes
    return layout._replace(modes=modes, moves=(trade, *moves), reported=(RESERVE,))


def read_reserve(
    where: TableContext, raw: dict, hours: Hours, energy: float, currency: str
) -> SoldReserve:
    """The table `reserve` of a store of `energy` MWh; blocks are those of the auctions, or single
    hours.

    **Raises:** `CaseError` if the minimum energy does not fit in the store, or a price is missing.
    """
    table = where.nested(ReserveTable, raw, RESERVE)
    low, high = (float(x) for x in table.stock)
    if high > energy:
        raise where.error("reserve.stock", [low, high], f"both must be at most energy, {energy:g}")
    price = table.price
    if isinstance(price, str):
        section = TableContext(where.file, f"{where.name}.{RESERVE}", where.notes)
        rows = rows_by_hour(FileReference(section, "price", price), hours)
        price = PRICE.from_rows(PRICE.name, rows, hours.local)
    first_steps = np.ones(len(hours.days), bool)
    if hours.notice is not None:
        first_steps = np.array(hours.notice[: len(hours.days)]) == 0
        first_steps[0] = True
    last_steps = np.append(first_steps[1:], True)
    return SoldReserve(  # pyright: ignore[reportCallIssue]
        replace(price, unit=f"{currency}/MW/h"),
        table.stock,
        first_steps,
        last_steps,
        moves=_moves(first_steps, last_steps),  # pyright: ignore[reportCallIssue]
    )
