"""A pension case as resolved data: the fund, its markets, its people and the question.

Conventions for every record. Time runs in steps of `PensionCase.step` years (1/12 or 1), step t
from time t * step to (t + 1) * step; T is the number of steps with a decision. Numbers are per
year and continuous unless a field has another unit, shares are fractions (0.05 is 5 %), money is
in `PensionCase.currency`. A `CaseInput` keeps the numbers as they were entered and becomes an input
with a sensitivity, unless `PensionCase.held` names it; equations use `x.values[x.index]`. Plain
NumPy arrays, integers and names have no gradient.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable
from snapo.problem.record import TreeRecord, field

from .assets import Assets, Overlay
from .market import Correlation, Credit, Currencies, Inflation, MarketCurve, SuppliedScenarios
from .people import CashFlows, FundMembers, LeeCarter, Mortality
from .plan import Liability, PensionPlan, Reconcile
from .pots import Pots
from .regulation import Funding, Regulation

if TYPE_CHECKING:
    from ..market.rates.short_rate import ShortRate


# At the horizon: the ratio F, ln(F / F now), A - L, min(F - 1, 0) …; "pv_" discounts from there.
AT_END = (
    "funding_ratio",
    "log_relative",
    "surplus",
    "surplus_ratio",
    "assets",
    "liability",
    "pv_assets",
    "pv_liability",
    "discount",
    "pv_shortfall",
)
# Sums over the steps. "pv_" are present values; "shortfall_square" is max(1 - F, 0)^2 times the
# years of a step; "normal_cost" is the value of the accrual; "granted" and "cut" are indexation.
# No sums: "funding" is F before the last step, "bound_excess" the largest excess over bounds.
EACH_STEP = (
    "contribution",
    "benefit",
    "expenses",
    "cost",
    "normal_cost",
    "granted",
    "cut",
    "pv_contribution",
    "pv_benefit",
    "pv_expenses",
    "pv_cost",
    "pv_accrual",
    "pv_indexation",
    "shortfall_square",
    "collateral_shortfall",
    "funding",
    "bound_excess",
)
OUTPUTS = AT_END + EACH_STEP


@dataclass(frozen=True, eq=False)
class ObjectiveTerm:
    """`weight` times one objective of one output of a path (see `OUTPUTS`)."""

    weight: float
    output: str
    objective: ObjectiveTable


@dataclass(frozen=True, eq=False)
class Frontier:
    """A sweep of contributions against the shortfall: the number of `points`, the training `steps`
    of every policy, and the `level` of the CVaR."""

    points: int
    steps: int
    level: float


class Scales(NamedTuple):
    """Standard deviations after ten years, 1 if nothing moves: of the `factors` [g], of ln(s /
    mean) of a `spread` [R], and of Lee-Carter's k."""

    factors: np.ndarray
    spread: np.ndarray
    mortality: np.ndarray


class DerivedNumbers(TreeRecord):
    """Numbers that follow from those of a case, whatever the values of its inputs.

    - `eligible`: [n] share of each class that counts as collateral.
    - `scales`: the scales of the features (see `fund.observation`).
    - `width`: the width of the factor of expected inflation (see `people.lpi`).
    - `divided`: whether birthdays lie within steps (see `people.mortality`).
    - `annual_bond`: 1 / (1 + annual zero rate) by step (see `fund.schedule`); None if it is not
      needed.
    """

    eligible: np.ndarray
    scales: Scales
    width: np.ndarray
    divided: bool = field(static=True)
    annual_bond: np.ndarray | None


class PensionModel(TreeRecord):
    """A fund, its markets and its people: everything on which its paths depend.

    The model of a case has all numbers. The model of a simulator is made from a case by
    `inputs.model_of`: it has every number that is not an input, as an array.

    - `step`: 1/12 or 1 years; `steps`: T; `start_month`: 1 to 12, the calendar month of time 0.
    - `measure`: "P" real-world, "Q" risk-neutral.
    - `members`, `cash_flows`: exactly one of them is not None; `mortality` is None without members.
    - `observation`: names that the policy sees (see `fund.observation.FEATURES`), in order.
    - `pots`: personal pots instead of promised rights; None if these are promised.
    - `derived`: the derived numbers, for a simulator only.
    """

    step: float = field(static=True)
    steps: int = field(static=True)
    start_month: int = field(static=True)
    measure: Literal["P", "Q"] = field(static=True)
    curve: MarketCurve
    rates: "ShortRate"
    inflation: Inflation
    assets: Assets
    credit: Credit
    currencies: Currencies
    correlation: Correlation
    overlay: Overlay | None
    members: FundMembers | None
    mortality: Mortality | None
    lee_carter: LeeCarter | None
    cash_flows: CashFlows | None
    plan: PensionPlan
    liability: Liability
    scenarios: SuppliedScenarios | None
    observation: tuple[str, ...] = field(static=True)
    pots: Pots | None = field(default=None, kw_only=True)
    derived: DerivedNumbers | None = field(default=None, kw_only=True)

    @property
    def risk_neutral(self) -> bool:
        return self.measure == "Q"

    @property
    def buckets(self) -> int:
        """The number of overlay buckets."""
        return 0 if self.overlay is None else len(self.overlay.maturities)


class PensionCase(PensionModel):
    """A pension case.

    - `held`: names of the `CaseInput`s that are not inputs of the simulator. `notes`: remarks for
      the user.
    - `slips`: names of numbers that are likely to be in another unit, according to one of the
      notes.
    - `parts`: names of the requested parts of a run, () for all.
    """

    file: Path = field(kw_only=True)
    title: str = field(kw_only=True)
    currency: str = field(kw_only=True)
    valuation_date: str = field(kw_only=True)
    reconcile: Reconcile | None = field(kw_only=True)
    hidden: tuple[int, ...] = field(kw_only=True)
    objective: tuple[ObjectiveTerm, ...] = field(kw_only=True)
    training: TrainingTable = field(kw_only=True)
    evaluation: EvaluationTable = field(kw_only=True)
    frontier: Frontier | None = None
    regulation: Regulation | None = None
    funding: Funding | None = None
    held: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    slips: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()

    # One case is equal to itself only.
    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return id(self)


PARTS = (
    "reconciliation", "stress", "training", "objective", "paths", "today", "sensitivities",
    "outputs", "certificate", "attribution", "variance by source", "market consistency",
    "classical policies", "frontier", "pots",
)  # fmt: skip
# Parts of promised rights only; a fund of pots has its own part.
OF_RIGHTS = ("attribution", "variance by source", "market consistency", "frontier")
# What moves or replaces the numbers of the models.
OF_MODELS = ("variance by source", "market consistency")


def missing_parts(case: PensionCase, stress: bool) -> dict[str, str]:
    """{part: the reason why a run of the case does not have it, or why it is empty}; `stress`:
    whether the case names a file of shocks."""
    result = {} if stress else {"stress": "the case has no [stress]"}
    if case.frontier is None:
        result["frontier"] = "the case has no [frontier]"
    if case.scenarios is not None:
        result |= dict.fromkeys(OF_MODELS, "ready-made [scenarios] replace the models")
    if case.pots is None:
        result["pots"] = "the case has no [pots]"
    else:
        result |= dict.fromkeys(OF_RIGHTS, "it is for promised rights, and this fund has [pots]")
    return result
