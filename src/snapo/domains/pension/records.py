"""A pension case as resolved data: the fund, its markets and what is asked; people: records_people.

Conventions for every record. Time runs in steps of `PensionCase.step` years (1/12 or 1), step t
from time t * step to (t + 1) * step; T is the number of steps with a decision. Numbers are per
year and continuous unless a field says otherwise, shares are fractions (0.05 is 5 %), money is
in `PensionCase.currency`. A `Given` keeps the numbers as the owner gave them and becomes an
input with a sensitivity under its own name, unless `PensionCase.held` names it; where it is
used it is `given.values[given.index]`. Plain NumPy arrays, integers and names have no gradient.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from snapo.case.given import Given
from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable

from .records_people import CashFlows, LeeCarter, Liability, Members, Mortality, Plan, Reconcile


@dataclass(frozen=True, eq=False)
class Curve:
    """Nominal zero curve, or break-evens of the same form (then rates are of inflation).

    - `tenor`: [n] nodes in years, strictly rising, above zero.
    - `rate`: [n], index [n], continuous, unit "1/year", labels "10y". Quote "zero": zero rates,
      linear between nodes, flat before the first. Quote "forward": the forward rate of the
      interval that ends at the node, constant in it.
    - `extrapolation`: beyond the last node "flat-forward" keeps the last forward rate;
      "ultimate" moves the forward rate to `ultimate` by exp(-speed * (years beyond the node)).
    - `ultimate`: forward rate far out, index []; used with "ultimate" only.
    """

    tenor: np.ndarray
    rate: Given
    quote: Literal["zero", "forward"]
    extrapolation: Literal["flat-forward", "ultimate"]
    ultimate: Given
    speed: float = 0.1


@dataclass(frozen=True, eq=False)
class RateModel:
    """Hull-White (F = 1) or G2++ (F = 2), fitted to the curve: r = sum of factors + phi(t).

    dx_i = -a_i x_i dt + s_i(t) (dW_i + lambda_i dt), x_i(0) = 0; lambda counts under "P" only.
    A negative price of risk is a positive bond premium.

    - `mean_reversion`: index [F], above zero. `volatility`: index [T, F], constant in a step.
    - `price_of_risk`: index [F], 1/sqrt(year).

    Correlations stand in `Correlation`, under the names "rate" and "rate 2".
    """

    kind: Literal["hull-white", "g2++"]
    mean_reversion: Given
    volatility: Given
    price_of_risk: Given


@dataclass(frozen=True, eq=False)
class Inflation:
    """Expected inflation p + phi_p(t) fitted to break-evens, realised prices, and wages.

    dp = -k p dt + s(t) (dW + lambda dt); d ln I = (phi_p + p) dt + s_I(t) (dW_I + lambda_I dt);
    d ln W = d ln I + real_wage dt + s_W dW_W. Prices of risk count under "P" only.

    - `break_even`: zero-coupon break-even curve.
    - `mean_reversion`, `price_of_risk`, `index_price_of_risk`, `real_wage_growth`,
      `wage_volatility`: index []. `volatility`, `index_volatility`: index [T].
    """

    break_even: Curve
    mean_reversion: Given
    volatility: Given
    price_of_risk: Given
    index_volatility: Given
    index_price_of_risk: Given
    real_wage_growth: Given
    wage_volatility: Given


AssetKind = Literal["cash", "equity", "property", "commodity", "hedge-fund", "bond", "credit"]


@dataclass(frozen=True, eq=False)
class AssetClass:
    """One row of the asset table. Exactly one class of a case is "cash".

    "equity" (listed, private, infrastructure), "property", "commodity", "hedge-fund" have a
    shock of their own; "bond" and "credit" are zero-coupon bonds of `maturity`, kept constant.

    - `maturity`: whole steps, "bond" and "credit" only, else 0.
    - `rating`: position in `PensionCase.ratings`, "credit" only, else -1.
    - `currency`: position in `PensionCase.currencies`, -1 for the fund's own.
    - `group`: name of a group, or "". `eligible`: share that counts as collateral, 0 to 1.
    """

    name: str
    kind: AssetKind
    maturity: int = 0
    rating: int = -1
    currency: int = -1
    group: str = ""
    eligible: float = 0.0


@dataclass(frozen=True, eq=False)
class Group:
    """The classes `members` (positions) together weigh between `low` and `high`."""

    name: str
    members: tuple[int, ...]
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Assets:
    """The asset classes; n is their number, m those with a shock of their own (`shocks`).

    - `mean`: index [m], per year. `return_kind` "excess": over cash, "total": all of the return,
      whatever cash earns. `mean_kind` "log": of the log return; "geometric": ln(1 + mean) is
      that; "arithmetic": 1 + mean is the expected gross return of a year, in the fund's own
      currency after hedging. Counts under "P" only: under "Q" every class earns cash on average.
    - `volatility`: index [T, m] in local currency, 1/sqrt(year).
    - `shocks`: [m] positions of the classes with a shock of their own.
    - `smoothing`: index [q], the share of a step's return that an appraisal shows at once, 0 to
      1; `smoothed`: [q] positions of the appraised classes ("property"), often none.
    - `cost`: index [n], share of what is traded; `fee`: index [n], share of assets per year.
    - `weight`: index [n], weights now, adding up to one.
    - `low`, `high`: [n] bounds between 0 and 1; `groups`: disjoint.
    - `amount`: market value of all assets now, index [].
    """

    classes: tuple[AssetClass, ...]
    return_kind: Literal["excess", "total"]
    mean_kind: Literal["geometric", "arithmetic", "log"]
    shocks: np.ndarray
    mean: Given
    volatility: Given
    smoothing: Given
    smoothed: np.ndarray
    cost: Given
    fee: Given
    weight: Given
    low: np.ndarray
    high: np.ndarray
    groups: tuple[Group, ...]
    amount: Given

    @property
    def cash(self) -> int:
        """The position of cash."""
        return next(i for i, each in enumerate(self.classes) if each.kind == "cash")


@dataclass(frozen=True, eq=False)
class Credit:
    """Spreads by rating; R is the number of ratings (0 allowed). u = ln(s / mean) is an OU process.

    - `names`: [R]. `spread` (now), `mean_spread` (both above 0), `mean_reversion`, `volatility`
      (of ln s), `default_loss` (share of a holding lost per year at the mean spread, moving in
      proportion to the spread): index [R]. Carry and loss count under "P" only.
    """

    names: tuple[str, ...]
    spread: Given
    mean_spread: Given
    mean_reversion: Given
    volatility: Given
    default_loss: Given


@dataclass(frozen=True, eq=False)
class Currencies:
    """Foreign currencies; X is their number (0 allowed).

    - `volatility`, `premium` (over the difference of rates; under "P" only), `hedge_ratio` (0 to
      1, the share of the exposure that is hedged), `hedge_cost` (share of the hedged amount per
      year): index [X].
    """

    names: tuple[str, ...]
    volatility: Given
    premium: Given
    hedge_ratio: Given
    hedge_cost: Given


@dataclass(frozen=True, eq=False)
class Correlation:
    """Instantaneous correlations: positive definite, repaired beforehand where the case asked.

    - `names`: [k] of what is correlated: "rate", "rate 2", "inflation", "price index", "wage",
      ratings, currencies, and classes with a shock of their own. What is not named here, and
      mortality, is independent of all the rest.
    - `lower`: strict lower triangle, row by row, index [k (k - 1) / 2]; labels "equity, rate".
    - `repaired`: the largest change of an entry, 0 where nothing was repaired.
    """

    names: tuple[str, ...]
    lower: Given
    repaired: float = 0.0


@dataclass(frozen=True, eq=False)
class Overlay:
    """Receiver swaps by tenor bucket, each a zero-coupon bond financed at cash; b buckets.

    - `maturity`: [b] whole steps, rising. `notional`: present value of the fixed leg now, money,
      index [b]. `low`, `high`: [b] limits as a share of `unit`: of assets, or of the value of
      the liability payments that are nearest to the bucket (a hedge ratio).
    - `leverage`: largest sum of absolute notionals over assets, index [].
    - `cost`: share of the notional traded, index [b].
    - `collateral_stress`: rise in rates that collateral must withstand, 0.035 is 350 bp, index [].
    """

    maturity: np.ndarray
    notional: Given
    low: np.ndarray
    high: np.ndarray
    unit: Literal["assets", "liability"]
    leverage: Given
    cost: Given
    collateral_stress: Given


@dataclass(frozen=True, eq=False)
class SuppliedScenarios:
    """Ready-made scenarios in place of the generator: two different sets of paths.

    - `training`, `evaluation`: [paths, T, K], over step t (returns, growth) or at its end (zeros).
    - `columns`: [K] "return CLASS" for every class (simple, of the step), then "inflation" and
      "wage" (log growth of the step), then "zero TENOR" (continuous) for each of `tenor`.
    - `tenor`: [k] years, rising; zero rates are linear between them and flat outside.
    """

    training: np.ndarray
    evaluation: np.ndarray
    columns: tuple[str, ...]
    tenor: np.ndarray


@dataclass(frozen=True, eq=False)
class ObjectiveTerm:
    """`weight` times one objective of one output of a path (see `simulator.OUTPUTS`)."""

    weight: float
    output: str
    objective: ObjectiveTable


@dataclass(frozen=True, eq=False)
class Frontier:
    """A sweep of contributions against the shortfall: `points` policies, each trained for `steps`
    more, CVaR at `level`."""

    points: int
    steps: int
    level: float


@dataclass(frozen=True, eq=False)
class PensionCase:
    """Everything that a pension case says.

    - `step`: 1/12 or 1 years; `steps`: T; `start_month`: 1 to 12, the calendar month of time 0.
    - `measure`: "P" real-world, "Q" risk-neutral.
    - `members` or `cash_flows`: exactly one of them is there; `mortality` goes with members.
    - `observation`: names of what the policy sees (see `observation.NAMES`), in order.
    - `held`: names of `Given`s that are no inputs. `notes`: remarks for the owner of the case.
    """

    file: Path
    title: str
    currency: str
    valuation_date: str
    step: float
    steps: int
    start_month: int
    measure: Literal["P", "Q"]
    curve: Curve
    rates: RateModel
    inflation: Inflation
    assets: Assets
    credit: Credit
    currencies: Currencies
    correlation: Correlation
    overlay: Overlay | None
    members: Members | None
    mortality: Mortality | None
    lee_carter: LeeCarter | None
    cash_flows: CashFlows | None
    plan: Plan
    liability: Liability
    reconcile: Reconcile | None
    scenarios: SuppliedScenarios | None
    observation: tuple[str, ...]
    hidden: tuple[int, ...]
    objective: tuple[ObjectiveTerm, ...]
    training: TrainingTable
    evaluation: EvaluationTable
    frontier: Frontier | None = None
    held: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    kind = "pension"

    @property
    def risk_neutral(self) -> bool:
        return self.measure == "Q"

    @property
    def buckets(self) -> int:
        """The number of overlay buckets."""
        return 0 if self.overlay is None else len(self.overlay.maturity)
