"""Rules of a scheme and how its promises are valued; conventions as in `records.case`."""

from typing import Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord, field


class Indexation(TreeRecord):
    """Increases of pensions in payment once a year in the calendar month `month`; if the plan has
    no `Revaluation`, all other rights increase equally.

    "none"; "fixed": by `rate`, a part of the payments themselves (see `people.fixed_increases`);
    "full": price growth since the last time; "capped": the same within `floor` and `cap` (per
    year); "conditional": the capped increase times a ramp, which is 0 at `lower_ratio` and 1 at
    `upper_ratio` of the policy ratio, the mean funding ratio of the last `averaging` months (1 to
    12). Cuts: if the policy ratio lies below `required_ratio`, pensions are cut by (1 - ratio /
    required_ratio) / `cut_years`; no cuts if `cut_years` is 0.

    `cap`, `floor`, `lower_ratio`, `upper_ratio`, `required_ratio`, `rate`: index [].
    """

    kind: Literal["none", "fixed", "full", "capped", "conditional"] = field(static=True)
    month: int = field(static=True)
    averaging: int = field(static=True)
    cap: CaseInput
    floor: CaseInput
    lower_ratio: CaseInput
    upper_ratio: CaseInput
    required_ratio: CaseInput
    cut_years: int = field(static=True)
    rate: CaseInput | None = None


class Revaluation(TreeRecord):
    """Increases of rights before payment, by fixed rates on the dates of `Indexation`: `deferred`
    for deferred members until their pension begins, `active` for active members. Index []."""

    deferred: CaseInput
    active: CaseInput


class CashPlan(TreeRecord):
    """Payments agreed in money, such as a recovery plan's.

    - `amount`: the money of each row, index [n]; `step`: [n] the step in which it is paid.
    """

    amount: CaseInput
    step: np.ndarray


class Contribution(TreeRecord):
    """The contribution of each step: normal cost plus recovery, then limits, and then `schedule`.

    - `kind` "none": nothing; "fixed": `rate` times salaries; "normal-cost": the normal cost only;
      "spread": normal cost plus `spread_factor` per year times (liability - assets), which a
      surplus makes negative; "target": normal cost plus the gap to `target_ratio` times the
      liability, as level payments in periods of `level_steps`; if that is None, the gap divided by
      `recovery_years` each year.
    - `normal_cost` "valuation": value of the step's accrual on the simulated curve, times
      1 + `loading`; "rate": `rate` times salaries.
    - `floor`, `cap`: share of salaries; `sponsor_limit`: maximum money per year, grows with wages.
      Each limit applies only if its flag is set. All `CaseInput`s have the index [].
    - `schedule`: payments in addition, without limits; None if the case has none.
    """

    kind: Literal["none", "fixed", "normal-cost", "spread", "target"] = field(static=True)
    normal_cost: Literal["valuation", "rate"] = field(static=True)
    rate: CaseInput
    loading: CaseInput
    spread_factor: CaseInput
    target_ratio: CaseInput
    recovery_years: CaseInput
    floor: CaseInput
    cap: CaseInput
    sponsor_limit: CaseInput
    has_floor: bool = field(static=True)
    has_cap: bool = field(static=True)
    has_sponsor_limit: bool = field(static=True)
    schedule: CashPlan | None = None
    level_steps: int | None = field(static=True, default=None)


class PensionPlan(TreeRecord):
    """Terms of the scheme: a career-average pension.

    - `revaluation`: the revaluation of rights before payment; None if they grow in the same way as
      pensions in payment.

    - `timing`: payments at the start ("advance") or end ("arrears") of a step, for both benefits
      and contributions.
    - `retirement_age`: whole or fractional years; it determines a date and has no gradient.
      `accrual_rate`: pension per year of service as a share of (salary - `offset`), index [];
      `offset`: money, index [].
    - `spouse_share`: share of the member's pension, index []; `married_share`: index [];
      `spouse_age_gap`: years by which wives are younger than their husbands (older if negative),
      whichever of the two is the member; it has no gradient.
    - `age_basis`: ages at the "nearest" or "last" birthday, or "exact" ages. `fractional_ages`: the
      distribution of deaths between birthdays, "constant-force" or "uniform".
    - `open`: every active who retires or dies is replaced by an entrant of `entry_age` with the
      same salary, so that payroll in wages of today stays constant. In a closed plan no one enters,
      and active members continue to accrue. With `accruing` False there is no new accrual (frozen
      plan).
    - `max_service`: years after which accrual ends. `expenses`: money per year, index [].
    """

    timing: Literal["advance", "arrears"] = field(static=True)
    retirement_age: float
    accrual_rate: CaseInput
    offset: CaseInput
    spouse_share: CaseInput
    married_share: CaseInput
    spouse_age_gap: int
    age_basis: Literal["nearest", "last", "exact"] = field(static=True)
    fractional_ages: Literal["constant-force", "uniform"] = field(static=True)
    open: bool = field(static=True)
    accruing: bool = field(static=True)
    entry_age: float
    max_service: float
    expenses: CaseInput
    indexation: Indexation
    contribution: Contribution
    revaluation: Revaluation | None = None


class Liability(TreeRecord):
    """The valuation of payments at any time.

    - `basis` "risk-free": the simulated curve; "spread": this curve plus `rate`; "fixed": `rate`
      for all terms. `rate`: index [], `annual` or continuous; an annual spread is added to annual
      rates of today's curve, term by term, and the resulting continuous spreads are held fixed.
    - `loading`: the loading for expenses, index []: reserves are (1 + `loading`) times the value
      of the payments.
    - `future_indexation`: "none" values nominal payments, "full" payments that follow prices (on
      the real curve; with the basis "fixed" `rate` is then real), "capped" payments that follow
      prices within the cap and the floor of the plan's indexation, valued as options
      (`people.lpi`).
    """

    basis: Literal["risk-free", "spread", "fixed"] = field(static=True)
    rate: CaseInput
    future_indexation: Literal["none", "full", "capped"] = field(static=True)
    annual: bool = field(static=True, default=False)
    loading: CaseInput | None = None


class Reconcile(TreeRecord):
    """The actuary's figures; a figure that the case does not have is None. `tolerance` is
    relative."""

    liability: float | None
    duration: float | None
    tolerance: float
