"""Survival: hazards by sex, age and calendar year, and survival of cohorts by step."""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, ArrayLike, Float
from snapo.problem.record.either import xp

from ..records.case import PensionModel
from ..records.inputs import use
from ..records.people import FEMALE, SLOPE_AGES, Mortality
from ..records.plan import PensionPlan

CERTAIN = 50.0  # the hazard of a year that no one survives: exp(-50) is 2e-22
TINY = 1e-9  # of a year: closer to a birthday than this is the birthday


def hazard(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, "2 G"]:
    """The hazard -ln(1 - q) of the year after each birthday, before multipliers and improvement. A
    death probability of 1 gives the hazard `CERTAIN`, without a gradient.
    """
    mortality = _mortality(case)
    if mortality.kind == "table":
        result = _hazard(use(inputs, mortality.table))
        later = mortality.ages - result.shape[1]
        return result if later == 0 else xp.concatenate([result, closed(result, later)], axis=1)
    alpha, beta, makeham = (part[:, None] for part in use(inputs, mortality.gompertz).T)
    age = mortality.first_age + np.arange(mortality.ages)
    return makeham + xp.exp(alpha + beta * age) * xp.expm1(beta) / beta


def closed(hazard: Float[Array, "2 n"], later: int) -> Float[Array, "2 later"]:
    """The hazards of `later` ages beyond a table: see `Mortality`."""
    last = hazard[:, -SLOPE_AGES:]
    logit = xp.log(last / (1 - last))
    position = np.arange(last.shape[1]) - (last.shape[1] - 1) / 2
    slope = logit @ (position / (position @ position))
    ahead = logit[:, -1:] + slope[:, None] * np.arange(1, later + 1)
    return 1 / (1 + xp.exp(-ahead))


def _hazard(q: Array) -> Array:
    """-ln(1 - q), `CERTAIN` and without a gradient where q is 1 or more."""
    mortal = q < 1
    return xp.where(mortal, -xp.log1p(-xp.where(mortal, q, 0.0)), CERTAIN)


def rounded_age(plan: PensionPlan, age: ArrayLike) -> Array:
    """Ages at time 0 by the convention of the valuation."""
    if plan.age_basis == "exact":
        return xp.asarray(age, float)
    return xp.floor(xp.asarray(age, float) + (0.5 if plan.age_basis == "nearest" else 0.0))


def divided(case: PensionModel) -> bool:
    """Whether birthdays of members, spouses or entrants lie within steps."""
    members = case.members if case.plan.age_basis == "exact" else None
    ages = [] if members is None else members.age
    steps = np.append(ages, case.plan.entry_age if case.plan.open else 0.0) / case.step
    return bool(np.any(np.abs(steps - np.round(steps)) * case.step > TINY))


def partner(plan: PensionPlan, sex: ArrayLike, age: Array) -> tuple[Array, Array]:
    """The sex and age of the spouse: the other sex, where wives are younger by `spouse_age_gap`."""
    sex = xp.asarray(sex)
    gap = xp.where(sex == FEMALE, plan.spouse_age_gap, -plan.spouse_age_gap)
    return 1 - sex, age + gap


class Yearly(NamedTuple):
    """Death in a whole year: `level` is -ln(1 - q), where q is first multiplied by `base`; `trend`
    is the improvement so far, a factor on the hazard."""

    base: Array
    level: Array
    trend: Array

    def hazard(self, factor: ArrayLike = 1.0) -> Array:
        """The hazard of the year, if q is multiplied by a further `factor`."""
        certain = self.level >= CERTAIN
        q = xp.where(certain, 1.0, self.base * factor * -xp.expm1(-self.level))
        return _hazard(q) * self.trend


def yearly(
    case: PensionModel, inputs: dict[str, Any], sex: ArrayLike, age: ArrayLike, year: np.ndarray
) -> Yearly:
    """Yearly mortality at whole `age` in the calendar year that is `year` years after time 0;
    shapes broadcast. Ages outside the table have the mortality of its first or last age."""
    mortality = _mortality(case)
    position = _place(mortality, sex, age)
    trend = use(inputs, mortality.improvement).ravel()
    return Yearly(
        base=use(inputs, mortality.multiplier).ravel()[position],
        level=hazard(case, inputs).ravel()[position],
        trend=xp.exp(-trend[position] * (mortality.since + year)),
    )


def step_hazards(
    case: PensionModel,
    inputs: dict[str, Any],
    sex: ArrayLike,
    age: ArrayLike,
    steps: int,
    loading: Array | None = None,
    factor: Array | None = None,
) -> Float[Array, "C steps"]:
    """The hazards of each step, -ln of the survival over it, for cohorts aged `age` [C] at time 0.

    A step across a birthday is divided at the birthday; its calendar year is that of its start.
    With a constant force the value is the hazard times the length; with uniform deaths, from s to
    t, it is -ln((1 - t q) / (1 - s q)).

    **Arguments:**

    - `loading`: [2, G] the factor on the hazard of each age, for a Lee-Carter response.
    - `factor`: [C] factors on the death probabilities of each cohort; None means ones.
    """
    time = np.arange(steps) * case.step
    since_birth = xp.asarray(age, float)[:, None] + time
    complete = xp.floor(since_birth + TINY)
    start = xp.maximum(since_birth - complete, 0.0)
    start = xp.where(start < TINY, 0.0, start)
    end = start + case.step
    end = xp.where(xp.abs(end - 1) < TINY, 1.0, end)
    year = np.floor(time + TINY)
    total, local = xp.zeros(complete.shape), 1.0 if factor is None else factor[:, None]
    parts = [(complete, start, xp.minimum(end, 1.0))]
    if case.derived is None or case.derived.divided:
        parts.append((complete + 1, 0 * start, xp.maximum(end - 1, 0.0)))
    sex = xp.asarray(sex)[:, None]
    for birthday, first, last in parts:
        rate = yearly(case, inputs, sex, birthday, year).hazard(local)
        part = _within(case.plan, rate, last) - _within(case.plan, rate, first)
        if loading is not None:
            part = part * loading.ravel()[_place(_mortality(case), sex, birthday)]
        total = total + part
    return total


def log_survival(
    case: PensionModel,
    inputs: dict[str, Any],
    sex: ArrayLike,
    age: ArrayLike,
    steps: int,
    factor: Array | None = None,
) -> Float[Array, "C steps+1"]:
    """The logarithm of the probability of being alive after each step, 0 at time 0; `factor` [C]
    multiplies q."""
    return accumulate(-step_hazards(case, inputs, sex, age, steps, factor=factor))


def accumulate(by_step: Float[Array, "C steps"]) -> Float[Array, "C steps+1"]:
    """Running sums from 0 at time 0."""
    return xp.concatenate([xp.zeros_like(by_step[:, :1]), xp.cumsum(by_step, axis=1)], axis=1)


def _within(plan: PensionPlan, rate: Array, until: Array) -> Array:
    """The hazard from the birthday to a fraction `until` of the year; that of the whole year is
    `rate`."""
    if plan.fractional_ages == "constant-force":
        return rate * until
    inside = until < 1
    q = -xp.expm1(-rate)
    return xp.where(inside, -xp.log1p(-xp.where(inside, until, 0.0) * q), rate)


def _place(mortality: Mortality, sex: ArrayLike, age: ArrayLike) -> Array:
    sex = xp.asarray(sex)
    within = xp.clip(xp.asarray(age).astype(int) - mortality.first_age, 0, mortality.ages - 1)
    return sex * mortality.ages + within


def _mortality(case: PensionModel) -> Mortality:
    if case.mortality is None:
        raise ValueError("mortality: a case of cash flows without members has none.")
    return case.mortality
