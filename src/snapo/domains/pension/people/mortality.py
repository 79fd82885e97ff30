"""Who is alive when: hazards by sex, age and calendar year, and survival of cohorts by step."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..records.case import PensionCase
from ..records.inputs import use
from ..records.people import FEMALE, Mortality
from ..records.plan import Plan

CERTAIN = 50.0  # the hazard of a year that nobody survives: exp(-50) is 2e-22
TINY = 1e-9  # of a year: closer to a birthday than this is the birthday


def hazard(case: PensionCase, inputs: dict[str, Any]) -> Float[Array, "2 G"]:
    """-ln(1 - q) of a whole year from each birthday, before multipliers and improvement.

    A death probability of 1 is a hazard of `CERTAIN`, without a gradient.
    """
    mortality = _mortality(case)
    if mortality.kind == "table":
        q = use(inputs, mortality.table)
        mortal = q < 1
        return jnp.where(mortal, -jnp.log1p(-jnp.where(mortal, q, 0.0)), CERTAIN)
    alpha, beta, makeham = (part[:, None] for part in use(inputs, mortality.gompertz).T)
    age = mortality.first_age + np.arange(mortality.ages)
    return makeham + jnp.exp(alpha + beta * age) * jnp.expm1(beta) / beta


def rounded_age(plan: Plan, age: np.ndarray) -> np.ndarray:
    """Ages at time 0 as the valuation counts them."""
    if plan.age_basis == "exact":
        return np.asarray(age, float)
    return np.floor(np.asarray(age, float) + (0.5 if plan.age_basis == "nearest" else 0.0))


def partner(plan: Plan, sex: np.ndarray, age: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sex and age of the spouse: the other sex, wives being younger by `spouse_age_gap`."""
    gap = np.where(sex == FEMALE, plan.spouse_age_gap, -plan.spouse_age_gap)
    return 1 - sex, age + gap


def yearly(
    case: PensionCase, inputs: dict[str, Any], sex: np.ndarray, age: np.ndarray, year: np.ndarray
) -> Array:
    """Hazard of a whole year at whole `age` in calendar `year` after time 0; shapes broadcast.

    hazard(x) multiplier(x) exp(-improvement(x) year). Ages outside the table take its ends.
    """
    mortality = _mortality(case)
    place = _place(mortality, sex, age)
    level = (hazard(case, inputs) * use(inputs, mortality.multiplier)).ravel()
    trend = use(inputs, mortality.improvement).ravel()
    return level[place] * jnp.exp(-trend[place] * year)


def step_hazards(
    case: PensionCase,
    inputs: dict[str, Any],
    sex: np.ndarray,
    age: np.ndarray,
    steps: int,
    loading: Array | None = None,
) -> Float[Array, "C steps"]:
    """-ln of survival over each step, of cohorts aged `age` [C] at time 0.

    A step across a birthday is divided there; the calendar year is that of its start. Constant
    force: hazard times length; uniform deaths: -ln((1 - t q) / (1 - s q)) from s to t.

    **Arguments:**

    - `loading`: [2, G]; the factor of the hazard of each age, in a Lee-Carter response.
    """
    time = np.arange(steps) * case.step
    since_birth = np.asarray(age, float)[:, None] + time
    whole = np.floor(since_birth + TINY)
    start = np.maximum(since_birth - whole, 0.0)
    start = np.where(start < TINY, 0.0, start)
    end = start + case.step
    end = np.where(np.abs(end - 1) < TINY, 1.0, end)
    year = np.floor(time + TINY)
    total = jnp.zeros(whole.shape)
    parts = ((whole, start, np.minimum(end, 1.0)), (whole + 1, 0 * start, np.maximum(end - 1, 0.0)))
    for birthday, first, last in parts:
        if np.all(last <= first):
            continue
        rate = yearly(case, inputs, sex[:, None], birthday, year)
        part = _within(case.plan, rate, last) - _within(case.plan, rate, first)
        if loading is not None:
            part = part * loading.ravel()[_place(_mortality(case), sex[:, None], birthday)]
        total = total + part
    return total


def log_survival(
    case: PensionCase, inputs: dict[str, Any], sex: np.ndarray, age: np.ndarray, steps: int
) -> Float[Array, "C steps+1"]:
    """ln of the probability to be alive after each step, 0 at time 0."""
    return accumulate(-step_hazards(case, inputs, sex, age, steps))


def accumulate(by_step: Float[Array, "C steps"]) -> Float[Array, "C steps+1"]:
    """Running sums from 0 at time 0."""
    return jnp.concatenate([jnp.zeros_like(by_step[:, :1]), jnp.cumsum(by_step, axis=1)], axis=1)


def _within(plan: Plan, rate: Array, until: np.ndarray) -> Array:
    """Hazard from the birthday to a fraction `until` of the year, all of it being `rate`."""
    if plan.fractional_ages == "constant-force":
        return rate * until
    inside = until < 1
    q = -jnp.expm1(-rate)
    return jnp.where(inside, -jnp.log1p(-np.where(inside, until, 0.0) * q), rate)


def _place(mortality: Mortality, sex: np.ndarray, age: np.ndarray) -> np.ndarray:
    within = np.clip(np.asarray(age).astype(int) - mortality.first_age, 0, mortality.ages - 1)
    return sex * mortality.ages + within


def _mortality(case: PensionCase) -> Mortality:
    if case.mortality is None:
        raise ValueError("mortality: a case of cash flows without members has none.")
    return case.mortality
