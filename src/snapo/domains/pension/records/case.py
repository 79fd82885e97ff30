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
from typing import TYPE_CHECKING, Literal

from snapo.case.settings import EvaluationTable, ObjectiveTable, TrainingTable

from .assets import Assets, Overlay
from .funding import Funding
from .market import Correlation, Credit, Currencies, Inflation, MarketCurve, SuppliedScenarios
from .people import CashFlows, FundMembers, LeeCarter, Mortality
from .plan import Liability, PensionPlan, Reconcile
from .pots import Pots
from .regulation import Regulation

if TYPE_CHECKING:
    from ..market.rates.short_rate import ShortRate


@dataclass(frozen=True, eq=False)
class ObjectiveTerm:
    """`weight` times one objective of one output of a path (see `fund.simulator.OUTPUTS`)."""

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
    """A pension case.

    - `step`: 1/12 or 1 years; `steps`: T; `start_month`: 1 to 12, the calendar month of time 0.
    - `measure`: "P" real-world, "Q" risk-neutral.
    - `members` or `cash_flows`: exactly one of them is there; `mortality` goes with members.
    - `observation`: names that the policy sees (see `fund.observation.FEATURES`), in order.
    - `pots`: personal pots instead of promised rights; None where these are promised.
    - `held`: names of `CaseInput`s that are no inputs. `notes`: remarks for the user.
    - `slips`: names of numbers that one of the notes supposes to be in another unit.
    - `parts`: names of those parts of a run that are wanted, () for all.
    """

    file: Path
    title: str
    currency: str
    valuation_date: str
    step: float
    steps: int
    start_month: int
    measure: Literal["P", "Q"]
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
    reconcile: Reconcile | None
    scenarios: SuppliedScenarios | None
    observation: tuple[str, ...]
    hidden: tuple[int, ...]
    objective: tuple[ObjectiveTerm, ...]
    training: TrainingTable
    evaluation: EvaluationTable
    frontier: Frontier | None = None
    regulation: Regulation | None = None
    funding: Funding | None = None
    pots: Pots | None = None
    held: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    slips: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()

    @property
    def risk_neutral(self) -> bool:
        return self.measure == "Q"

    @property
    def buckets(self) -> int:
        """The number of overlay buckets."""
        return 0 if self.overlay is None else len(self.overlay.maturity)
