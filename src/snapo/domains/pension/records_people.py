"""Members, mortality, plan and liability of a pension case; conventions as in `records`.

C is the number of cohorts, S the number of steps until the last payment (`PAYMENT_YEARS` years).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from snapo.case.given import Given

MALE, FEMALE = 0, 1
ACTIVE, DEFERRED, PENSIONER, SPOUSE = 0, 1, 2, 3
PAYMENT_YEARS = 100


@dataclass(frozen=True, eq=False)
class Mortality:
    """Death probabilities of a year by sex and age, with yearly improvement.

    Kind "table": `table` [sex, age] = q, from `first_age` on; the last age's q holds for all later
    ages (a q of 1 ends all lives). Kind "gompertz-makeham": mu(x) = makeham + exp(alpha + beta x)
    and q = 1 - exp(-integral of mu over the year).
    Either way q(x, year j) = 1 - (1 - q(x))^(multiplier(x) exp(-improvement(x) j)).

    - `first_age`: of all index axes "age"; ages have length G.
    - `table`: index [2, G]; empty for the other kind. `gompertz`: index [2, 3], columns alpha,
      beta, makeham; empty for "table".
    - `multiplier`: on the hazard, index [2, G]. `improvement`: per year, index [2, G].
    """

    kind: Literal["table", "gompertz-makeham"]
    first_age: int
    ages: int
    table: Given
    gompertz: Given
    multiplier: Given
    improvement: Given


@dataclass(frozen=True, eq=False)
class LeeCarter:
    """ln hazard(x, t) moves by b(x) k(t), k a random walk from 0 with no drift.

    The drift belongs to `Mortality.improvement`.

    - `volatility`: of k, 1/sqrt(year), index []. `loading`: b, index [2, G].
    """

    volatility: Given
    loading: Given


@dataclass(frozen=True, eq=False)
class Members:
    """Cohorts of a table; every array has length C.

    - `status`: ACTIVE, DEFERRED, PENSIONER, SPOUSE; `sex`: MALE, FEMALE.
    - `age`: exact ages in years at time 0 (fractions allowed where the case asks for them).
    - `number`: members, index [C]. `pension`: accrued per member and year, index [C]. `salary`:
      per member and year, index [C] (0 for those who are not active).
    - `service`: [C] years until now, for reports and for `Plan.max_service`.
    """

    names: tuple[str, ...]
    status: np.ndarray
    sex: np.ndarray
    age: np.ndarray
    number: Given
    pension: Given
    salary: Given
    service: np.ndarray


@dataclass(frozen=True, eq=False)
class CashFlows:
    """The actuary's vector of expected nominal payments, where that is all there is.

    - `amount`: money of each row given, index [n]; `step`: [n] the step in which it is paid.
    - `normal_cost`: money per step at time 0, grows with wages, index []; `salary`: per year.
    """

    amount: Given
    step: np.ndarray
    normal_cost: Given
    salary: Given


@dataclass(frozen=True, eq=False)
class Indexation:
    """Increases of all pensions, accrued and in payment, once a year in calendar month `month`.

    "none"; "full": price growth since the last time; "capped": the same within `floor` and
    `cap` (per year); "conditional": the capped one times a ramp, 0 at `lower_ratio` and 1 at
    `upper_ratio` of the policy ratio, the mean funding ratio of the last `averaging` months
    (1 to 12). Cuts: where the policy ratio lies below `required_ratio`, pensions are cut by
    (1 - ratio / required_ratio) / `cut_years`; no cuts where `cut_years` is 0.

    `cap`, `floor`, `lower_ratio`, `upper_ratio`, `required_ratio`: index [].
    """

    kind: Literal["none", "full", "capped", "conditional"]
    month: int
    averaging: int
    cap: Given
    floor: Given
    lower_ratio: Given
    upper_ratio: Given
    required_ratio: Given
    cut_years: int


@dataclass(frozen=True, eq=False)
class Contribution:
    """What is paid in each step; C = normal cost + recovery, then limits.

    - `kind` "none": nothing; "fixed": `rate` times salaries; "normal-cost"; "spread": normal cost
      plus `spread_factor` per year times (liability - assets), surplus is spread too;
      "target": normal cost plus what is missing to `target_ratio` times the liability, over
      `recovery_years`.
    - `normal_cost` "valuation": value of the step's accrual on the simulated curve, times
      1 + `loading`; "rate": `rate` times salaries.
    - `floor`, `cap`: share of salaries; `sponsor_limit`: most money per year, grows with wages.
      Each applies only where its flag is set. All `Given`s index [].
    """

    kind: Literal["none", "fixed", "normal-cost", "spread", "target"]
    normal_cost: Literal["valuation", "rate"]
    rate: Given
    loading: Given
    spread_factor: Given
    target_ratio: Given
    recovery_years: Given
    floor: Given
    cap: Given
    sponsor_limit: Given
    has_floor: bool
    has_cap: bool
    has_sponsor_limit: bool


@dataclass(frozen=True, eq=False)
class Plan:
    """Terms of the scheme: career average, pensions and accrued rights indexed alike.

    - `timing`: payments at the start ("advance") or end ("arrears") of a step, benefits and
      contributions alike.
    - `retirement_age`: whole or fractional years, no gradient (a date). `accrual_rate`: pension
      per year of service as a share of (salary - `offset`), index []; `offset`: money, index [].
    - `spouse_share`: of the member's pension, index []; `married_share`: index [];
      `spouse_age_gap`: years by which wives are younger than their husbands, whoever of the two
      is the member: a woman's husband is older by the gap (the reverse if negative), no gradient.
    - `age_basis`: "nearest" or "last" birthday or "exact"; `fractional_ages`: between
      birthdays "constant-force", "uniform" deaths.
    - `open`: every active who retires or dies is replaced by an entrant of `entry_age` with the
      same salary, so that payroll in wages of today stays constant. Closed: nobody enters, actives
      go on accruing. `accruing` False: no new accrual at all (frozen plan).
    - `max_service`: years after which accrual ends. `expenses`: money per year, index [].
    """

    timing: Literal["advance", "arrears"]
    retirement_age: float
    accrual_rate: Given
    offset: Given
    spouse_share: Given
    married_share: Given
    spouse_age_gap: int
    age_basis: Literal["nearest", "last", "exact"]
    fractional_ages: Literal["constant-force", "uniform"]
    open: bool
    accruing: bool
    entry_age: float
    max_service: float
    expenses: Given
    indexation: Indexation
    contribution: Contribution


@dataclass(frozen=True, eq=False)
class Liability:
    """How payments are valued at any time.

    - `basis` "risk-free": the simulated curve; "spread": the same plus `rate`; "fixed": `rate`
      for all terms (continuous). `rate`: index [].
    - `future_indexation`: "none" values nominal payments, "full" payments that follow prices (real
      curve; basis "fixed" then takes `rate` as real).
    """

    basis: Literal["risk-free", "spread", "fixed"]
    rate: Given
    future_indexation: Literal["none", "full"]


@dataclass(frozen=True, eq=False)
class Reconcile:
    """The actuary's own figures; None where not given. `tolerance` is relative."""

    liability: float | None
    duration: float | None
    tolerance: float
