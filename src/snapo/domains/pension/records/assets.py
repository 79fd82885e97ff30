"""Holdings of the fund as resolved data; conventions as in `records.case`."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord, field

from .market import as_tuple

AttributionPart = Literal["cash", "rates", "credit", "assets"]


@dataclass(frozen=True)
class AssetRow:
    """One row of the asset table, with the properties of its kind. Exactly one row of a case is
    cash.

    - `currency`: position in `PensionCase.currencies`, -1 for the fund's own.
    - `group`: name of a group, or "". `eligible`: share that counts as collateral, 0 to 1.

    A kind, a subclass of `market.assets.asset_class.AssetClass`, sets:

    - `kind`: the word in the table; `description`: its meaning in one phrase, for the report.
    - `part`: the part of an attribution to which its return over cash belongs.
    - `collateral`: the eligible share, if the table has none.
    - `risk`: the regulatory risk class in addition to rates and spreads, if the table has none; one
      of `records.regulation.RISKS`, "none" if there is no such risk.
    - `linked`: whether its payments follow prices.
    - `own_shock`: whether it has a separate mean and volatility, and so counts as a growth class.
    """

    kind: ClassVar[str]
    description: ClassVar[str]
    part: ClassVar[AttributionPart]
    risk: ClassVar[str]
    collateral: ClassVar[float] = 0.0
    linked: ClassVar[bool] = False
    own_shock: ClassVar[bool] = False
    is_cash: ClassVar[bool] = False

    name: str
    currency: int = -1
    group: str = ""
    eligible: float = 0.0


class AssetGroup(TreeRecord):
    """The classes `members` (positions) together weigh between `low` and `high`."""

    name: str = field(static=True)
    members: tuple[int, ...] = field(static=True)
    low: float
    high: float


class Assets(TreeRecord):
    """The asset classes; n is their number, m the number of those with a separate shock (`shocks`).

    - `mean`: index [m], per year. `return_kind` is "excess" for returns over cash, "total" for the
      whole return including that of cash. `mean_kind` "log": the mean of the log return;
      "geometric": ln(1 + mean) is the mean of the log return; "arithmetic": 1 + mean is the
      expected gross return of a year, in the fund's own currency after hedging. It is used under
      "P" only: under "Q" every class earns the return of cash on average.
    - `volatility`: index [T, m] in local currency, 1/sqrt(year).
    - `smoothing`: index [q], the share of a step's return that appraised prices show at once, 0 to
      1; `smoothed`: [q] positions of the appraised classes (such as property), often none.
    - `cost`: index [n], share of the trade; `fee`: index [n], share of assets per year.
    - `weight`: index [n], weights now, adding up to one.
    - `low`, `high`: [n] bounds of the weights; `groups`: groups of classes, which do not overlap. A
      class whose `low` is below 0 may be sold short, or, as cash, be borrowed; others may then
      weigh more than 1.
    - `amount`: market value of all assets now, index [].
    - `max_sale`: [n] share of a holding that may be sold per year, infinite without a limit;
      `band`: [n] distance from the wanted weight within which a class is not traded; `turnover`:
      half the sum of all changes of weights per year. None if no class has a limit.
    - `short`: whether a weight may be negative, so that more than the assets may be lost.
    - `risk`: [n] the regulatory risk class of each, one of `regulation.RISKS`.
    """

    classes: tuple[AssetRow, ...] = field(static=True)
    return_kind: Literal["excess", "total"] = field(static=True)
    mean_kind: Literal["geometric", "arithmetic", "log"] = field(static=True)
    mean: CaseInput
    volatility: CaseInput
    smoothing: CaseInput
    smoothed: tuple[int, ...] = field(static=True, converter=as_tuple)
    cost: CaseInput
    fee: CaseInput
    weight: CaseInput
    low: np.ndarray
    high: np.ndarray
    groups: tuple[AssetGroup, ...]
    amount: CaseInput
    max_sale: np.ndarray | None = None
    band: np.ndarray | None = None
    turnover: float | None = None
    risk: tuple[str, ...] = field(static=True, default=())
    short: bool = field(static=True, init=False)

    def __post_init__(self):
        object.__setattr__(self, "short", bool((np.asarray(self.low) < 0).any()))

    @property
    def cash(self) -> int:
        """The position of cash."""
        return next(i for i, class_ in enumerate(self.classes) if class_.is_cash)

    @property
    def shocks(self) -> tuple[int, ...]:
        """[m] positions of the classes with a separate shock."""
        return tuple(i for i, class_ in enumerate(self.classes) if class_.own_shock)


class Overlay(TreeRecord):
    """Receiver swaps by tenor bucket; b buckets.

    - `inflation`: the number of zero-coupon swaps of inflation, which are the last buckets (they
      receive the growth of prices); the others are interest rate swaps, at par except at the
      positions `zero_coupon`.
    - `maturities`: [b] whole steps, rising among swaps of rates and of inflation. `notional`:
      money, the value of the fixed leg when the swap is struck, index [b].
    - `low`, `high`: [b] limits as a share of `unit`: of the assets, or of the value of the
      liability payments that are nearest to the bucket (a hedge ratio).
    - `leverage`: largest sum of absolute notionals, divided by the assets, index [].
    - `cost`: share of the notional traded, index [b].
    - `collateral_stress`: rise in rates that collateral must withstand (0.035 is 350 bp), index [].
    """

    maturities: tuple[int, ...] = field(static=True, converter=as_tuple)
    notional: CaseInput
    low: np.ndarray
    high: np.ndarray
    unit: Literal["assets", "liability"] = field(static=True)
    leverage: CaseInput
    cost: CaseInput
    collateral_stress: CaseInput
    inflation: int = field(static=True, default=0)
    zero_coupon: tuple[int, ...] = field(static=True, default=())

    @property
    def maturity(self) -> np.ndarray:
        """`maturities` as an array [b]."""
        return np.array(self.maturities, int)

    @property
    def at_par(self) -> np.ndarray:
        """Whether a swap is an interest rate swap at par, [b]."""
        position = np.arange(len(self.maturity))
        return (position < len(position) - self.inflation) & ~np.isin(position, self.zero_coupon)
