"""An asset class: a row of the asset table, with the behaviour of its kind.

A kind is a subclass in a separate file of this folder: its columns and their reader, its returns,
the dependence of its price on curves and spreads, and its description. Classes of one kind are
handled together: the class methods take the indices `positions` [k] of a case's classes.
"""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np

from snapo.case.csv import Row
from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ...read.cells import position
from ...records.assets import AssetRow
from ...records.case import PensionModel
from ...records.regulation import RISKS
from ..bonds.payments import Payments, Prices, curve_prices, ratio
from ..factors import MarketFactors, Moments
from ..spreads import CurrencyTerms

# Columns that not every kind has; `AssetClass.columns` lists those of a kind.
SPECIAL = ("mean", "volatility", "maturity", "coupon", "rating", "smoothing")


class AssetNames(NamedTuple):
    """The data to which a row of the table refers: the length of a step in years, the ratings and
    the currencies."""

    step: float
    ratings: Sequence[str]
    currencies: Sequence[str]

    def rating(self, row: Row) -> int:
        """The position of the rating in a row, -1 for none."""
        return position(row, "rating", self.ratings, "rating in [credit]")

    def currency(self, row: Row) -> int:
        """The position of the currency in a row, -1 for the fund's own."""
        return position(row, "currency", self.currencies, "currency in [currencies]")


class Scene(NamedTuple):
    """The data from which all kinds prepare their returns; the `moments` are those of nominal
    bonds."""

    case: PensionModel
    inputs: dict[str, Any]
    factors: MarketFactors
    covariance: Float[Array, "Z Z"]
    currencies: CurrencyTerms
    moments: Moments


class Now(NamedTuple):
    """A step of the market, as used by returns.

    `shock` [Z]: the Gaussian vector; `volatility` [g]: volatility of the factors;
    `index_volatility`: volatility of prices; `cash`: the log return of cash; `factors` [g]:
    factors of rates and expected inflation before the step; `spread` [R]: ln(s / mean) before the
    step; `foreign` [X]: log returns of the unhedged share of each currency, None without
    currencies.
    """

    shock: Array
    volatility: Array
    index_volatility: Array
    cash: Array
    factors: Array
    spread: Array | None
    foreign: Array | None


class AssetMixture(NamedTuple):
    """Holdings made of bonds: `log` [q] are the Gaussian log returns of the bonds over cash.
    `share` [k, q] are the weights of the bonds in each holding, fixed before the step; the gain of
    a holding over cash is share @ expm1(log)."""

    share: Array
    log: Array


class AssetClass(AssetRow, ABC):
    """The behaviour of one kind of asset class. A kind sets the attributes of `AssetRow`, and also
    `columns`, the columns of `SPECIAL` that it has, and `without`, the reason why it has no others.
    """

    columns: ClassVar[tuple[str, ...]]
    without: ClassVar[str]

    @classmethod
    @abstractmethod
    def read(cls, row: Row, names: AssetNames) -> dict[str, Any]:
        """The fields that this kind adds, from the row's columns."""

    @classmethod
    @abstractmethod
    def prepare(cls, scene: Scene, positions: Sequence[int]) -> tuple[Any, Any]:
        """The numbers of these classes that all paths share: constants, and [T, …] per step."""

    @classmethod
    @abstractmethod
    def log_return(
        cls, case: PensionModel, positions: Sequence[int], terms: Any, steps: Any, now: Now
    ) -> Float[Array, " k"]:
        """Log returns of these classes over a step; `terms`, `steps` are those of `prepare`."""

    @classmethod
    @abstractmethod
    def payments(cls, case: PensionModel, positions: Sequence[int]) -> Payments | None:
        """The payments of these classes, through which they follow the curve; None if they do not
        follow it."""

    @classmethod
    def ratings(cls, case: PensionModel, positions: Sequence[int]) -> np.ndarray:
        """[k] positions of the ratings whose spreads affect their prices, -1 for none."""
        return np.full(len(positions), -1)

    @classmethod
    def mixture(
        cls, case: PensionModel, positions: Sequence[int], terms: Any, steps: Any, now: Now
    ) -> AssetMixture | None:
        """The underlying bonds of these classes if their log returns are not Gaussian; else
        None."""
        return None

    @classmethod
    def ratio(
        cls, case: PensionModel, positions: Sequence[int], before: Prices, after: Prices
    ) -> Float[Array, " k"]:
        """The ratio of values after to values before, if the prices of payments move from `before`
        to `after`."""
        due = cls.payments(case, positions)
        return xp.ones(len(positions)) if due is None else ratio(due, cls.linked, before, after)

    @classmethod
    def log_price(
        cls, case: PensionModel, inputs: dict[str, Any], positions: Sequence[int]
    ) -> Float[Array, " k"]:
        """The logarithm of prices divided by those at the case's numbers. Its derivatives are the
        exposures to curves, break-evens and spreads."""
        now = curve_prices(case, {}), curve_prices(case, inputs)
        return xp.log(cls.ratio(case, positions, *now))

    @classmethod
    def of(cls, case: PensionModel, positions: Sequence[int]) -> list[Self]:
        """The classes at these positions."""
        return [case.assets.classes[i] for i in positions]  # pyright: ignore[reportReturnType]

    @classmethod
    def currencies(cls, case: PensionModel, positions: Sequence[int]) -> np.ndarray:
        """The positions of their currencies [k], -1 for the fund's own currency."""
        return np.array([item.currency for item in cls.of(case, positions)], int)


KINDS: dict[str, type[AssetClass]] = {}
AnyKind = TypeVar("AnyKind", bound=type[AssetClass])


def register(kind: AnyKind) -> AnyKind:
    """Registers a kind by its keyword; an incomplete or a duplicate kind is an error."""
    needed = ("kind", "description", "columns", "without", "part", "risk")
    missing = [name for name in needed if not hasattr(kind, name)]
    # Each kind defines its risk: an inherited one would hide that it was forgotten.
    missing += ["its own risk"] * ("risk" not in vars(kind) and "risk" not in missing)
    missing += sorted(getattr(kind, "__abstractmethods__", ()))
    if missing or inspect.isabstract(kind):
        raise TypeError(f"{kind.__name__}: a kind of asset class needs {', '.join(missing)}.")
    if unknown := set(kind.columns) - set(SPECIAL):
        raise TypeError(f"{kind.__name__}: there are no columns {', '.join(sorted(unknown))}.")
    if kind.risk not in RISKS:
        raise TypeError(
            f"{kind.__name__}: there is no risk {kind.risk!r}; the risks are {', '.join(RISKS)}."
        )
    if kind.kind in KINDS:
        raise TypeError(
            f"{kind.__name__}: the kind {kind.kind!r} is already registered by "
            f"{KINDS[kind.kind].__name__}."
        )
    KINDS[kind.kind] = kind
    return kind


def by_kind(case: PensionModel) -> list[tuple[type[AssetClass], tuple[int, ...]]]:
    """The kinds in a case, in the order of their first class, and the positions of their
    classes."""
    by_type: dict[type[AssetClass], list[int]] = {}
    for i, class_ in enumerate(case.assets.classes):
        assert isinstance(class_, AssetClass)
        by_type.setdefault(type(class_), []).append(i)
    return [(kind, tuple(positions)) for kind, positions in by_type.items()]


def in_order(case: PensionModel, parts: Sequence[Array]) -> Array:
    """[n] one row per class from one array per kind, as `by_kind` divides them."""
    positions = np.concatenate([np.array(item, int) for _, item in by_kind(case)])
    return xp.concatenate(parts)[np.argsort(positions)]


def log_prices(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, " n"]:
    """The logarithm of the price of every class divided by today's (see `AssetClass.log_price`)."""
    return in_order(case, [kind.log_price(case, inputs, at) for kind, at in by_kind(case)])


def ratios(case: PensionModel, before: Prices, after: Prices) -> Float[Array, " n"]:
    """The ratio of values after to values before, for all classes (see `AssetClass.ratio`)."""
    return in_order(case, [kind.ratio(case, at, before, after) for kind, at in by_kind(case)])
