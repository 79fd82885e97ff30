"""Members and mortality of a pension case; conventions as in `records.case`.

C is the number of cohorts, S the number of steps until the last payment (`PAYMENT_YEARS` years).
"""

from typing import Literal

import numpy as np

from snapo.case.given import CaseInput
from snapo.problem.record import TreeRecord, field

MALE, FEMALE = 0, 1
ACTIVE, DEFERRED, PENSIONER, SPOUSE = 0, 1, 2, 3
PAYMENT_YEARS = 100
SLOPE_AGES = 20  # the oldest of a table, whose slope closes it


class Mortality(TreeRecord):
    """Death probabilities of a year by sex and age, with yearly improvement.

    Kind "table": `table` [sex, age] = q, from `first_age` on. A table of fewer than G ages is
    extrapolated: the logit of the hazard continues from the last age with the slope of the last
    `SLOPE_AGES` ages (V. Kannisto). The rate of the last age applies to later ones (a q of 1 ends
    all lives). Kind "gompertz-makeham": mu(x) = makeham + exp(alpha + beta x) and q = 1 -
    exp(-integral of mu over the year). Either way, j years after time 0, q(x, j) = 1 - (1 - m
    q(x))^exp(-improvement(x) (since + j)), m = `multiplier(x)` times the factor of the cohort, and
    m q at most 1.

    - `first_age`: the first age of every axis of ages, whose length is G.
    - `table`: index [2, ages of the table]; empty for the other kind. `gompertz`: index [2, 3],
      columns alpha, beta, makeham; empty for "table".
    - `multiplier`: a factor on q, index [2, G]. `improvement`: per year, index [2, G].
    - `since`: years of improvement from the table's year to time 0.
    """

    kind: Literal["table", "gompertz-makeham"] = field(static=True)
    first_age: int = field(static=True)
    ages: int = field(static=True)
    table: CaseInput
    gompertz: CaseInput
    multiplier: CaseInput
    improvement: CaseInput
    since: float = 0.0


class LeeCarter(TreeRecord):
    """ln hazard(x, t) moves by b(x) k(t), where k is a random walk from 0 without drift.
    `Mortality.improvement` contains the drift.

    - `volatility`: the volatility of k, 1/sqrt(year), index []. `loading`: b, index [2, G].
    """

    volatility: CaseInput
    loading: CaseInput


class FundMembers(TreeRecord):
    """Cohorts of a table; every array has length C.

    - `status`: ACTIVE, DEFERRED, PENSIONER, SPOUSE; `sex`: MALE, FEMALE.
    - `age`: exact ages in years at time 0 (fractions if the case requests them).
    - `number`: members, index [C]. `pension`: accrued pension per member and year, index [C].
      `salary`: per member and year, index [C] (0 for those who are not active).
    - `service`: [C] years until now, for reports and for `PensionPlan.max_service`.
    - `mortality`: factor on the members' q, index [C]; None if the table has none.
    """

    names: tuple[str, ...] = field(static=True)
    status: np.ndarray
    sex: np.ndarray
    age: np.ndarray
    number: CaseInput
    pension: CaseInput
    salary: CaseInput
    service: np.ndarray
    mortality: CaseInput | None = None


class CashFlows(TreeRecord):
    """The actuary's vector of expected nominal payments, for a case without members.

    - `amount`: the amount of each row, index [n]; `step`: [n] the step in which it is paid.
    - `normal_cost`: money per step at time 0, which grows with wages, index []; `salary`: salaries
      per year.
    """

    amount: CaseInput
    step: np.ndarray
    normal_cost: CaseInput
    salary: CaseInput
