"""The derivative of everything about members and plan, by every number, against differences."""

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from tests.domains.pension.people_cases import (
    cash_flows,
    contributing,
    given,
    gompertz_table,
    indexing,
    lee_carter,
    members,
    mortality,
    people_case,
    plan,
)

from snapo.domains.pension.fund.plan import contribution, indexation
from snapo.domains.pension.fund.schedule import basis_log_bond
from snapo.domains.pension.fund.terms import plan_terms
from snapo.domains.pension.people.liability import people
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.domains.pension.records.plan import Liability
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy
from snapo.problem.smooth import Smooth

# Nobody's death is certain here: a probability of 1 has no derivative.
TABLE = mortality(table=gompertz_table()[:, :60])
ADDED = Liability("spread", given("liability_rate", 0.01), "full")
# Steps across birthdays, and a response to the mortality factor at the ages of that table.
BETWEEN = members(age=np.array([35.4, 62.0, 50.7, 70.1, 76.0]))
FACTOR = replace(lee_carter(), loading=given("loading", lee_carter().loading.used()[:, :60]))
CASES: dict[str, dict[str, Any]] = {
    "all": {
        "step": 1.0,
        "members": BETWEEN,
        "mortality": TABLE,
        "lee_carter": FACTOR,
        "liability": ADDED,
        "plan": plan(age_basis="exact"),
    },
    "open": {
        "step": 1.0,
        "mortality": TABLE,
        "plan": plan(open=True, timing="arrears", fractional_ages="uniform"),
    },
    "formula": {"step": 1.0, "mortality": mortality("gompertz-makeham")},
    "flows": {
        "members": None,
        "mortality": None,
        "cash_flows": cash_flows([10.0, 20.0, 30.0], [0, 12, 30], 2.0, 120.0),
    },
}
# What is no part of what members mean, by the beginning of its name.
OTHERS = ("asset", "rate_", "inflation", "index", "contribution")


def whole(case):
    """A function of all inputs that every number of the schedule enters with a weight of its own."""
    random = np.random.default_rng(3)

    def value(inputs):
        found = people(case, inputs, basis_log_bond(case, inputs))
        total = jnp.zeros(())
        for leaf, weight in zip(jax.tree.leaves(found), weights):
            total = total + jnp.sum(weight * leaf)
        return total

    inputs = plain(pension_inputs(case))
    log_bond = with_numpy(basis_log_bond)(case, inputs)
    found = with_numpy(people)(case, inputs, log_bond)
    weights = [
        random.uniform(0.5, 1.5, leaf.shape) / max(float(np.abs(leaf).sum()), 1e-6)
        for leaf in jax.tree.leaves(found)
    ]
    return jax.jit(value), inputs


def slopes(value, inputs):
    """Differences of fourth order at every entry of every input; `value` as `of_points` makes it."""
    centre, unravel = ravel_pytree(inputs)
    steps = 1e-3 * np.maximum(np.abs(centre), 1e-2)
    one, two = np.diag(steps), 2 * np.diag(steps)
    points = centre + np.concatenate([one, -one, two, -two])
    at = np.asarray(value(points)).reshape(4, -1)
    return unravel((8 * (at[0] - at[1]) - (at[2] - at[3])) / (12 * steps))


def of_points(value, inputs):
    """`value` of many points [points, numbers of `inputs`], one after another, compiled."""
    unravel = ravel_pytree(inputs)[1]
    return jax.jit(
        lambda points, *others: jax.lax.map(lambda x: value(unravel(x), *others), points)
    )


SLOW = pytest.param("open", marks=pytest.mark.study)


@pytest.mark.prove
@pytest.mark.parametrize("name", [*(name for name in CASES if name != "open"), SLOW])
def test_every_number_of_members_and_mortality(name):
    case = people_case(3, **CASES[name])
    with jax.enable_x64(True):
        value, inputs = whole(case)
        adjoint = jax.jit(jax.grad(value))(inputs)
        differences = slopes(of_points(value, inputs), inputs)
        for key, centre in inputs.items():
            if key.startswith(OTHERS):
                assert not np.any(adjoint[key])
                continue
            difference = differences[key]
            scale = 1e-6 * np.abs(difference) + 1e-10 / np.maximum(np.abs(centre), 1e-2)
            assert np.all(np.abs(adjoint[key] - difference) < scale), key
            # The factor's own volatility matters on the paths only.
            if name == "all" and key != "lee_carter_volatility":
                assert np.any(adjoint[key]), key


RULES = {
    "target": plan(
        indexation=indexing("conditional"), contribution=contributing("target", has_cap=True)
    ),
    "spread": plan(
        indexation=indexing("capped", cut_years=3),
        contribution=contributing("spread", has_floor=True, has_sponsor_limit=True),
    ),
    "rate": plan(
        indexation=indexing("full"), contribution=contributing("spread", normal_cost="rate")
    ),
}


@cache
def of_rules(name):
    """What the rules pay and give, of (their inputs, the funding ratio): its derivatives and its
    values at many points, compiled once for all ratios."""
    terms = RULES[name]
    case = people_case(plan=terms)

    def value(inputs, ratio):
        numbers = plan_terms(case, inputs)
        smooth = Smooth(0.3)
        shared = {"payroll": 50.0, "wage": 1.1, "step": 1 / 12, "smooth": smooth}
        paid = contribution(
            terms, numbers, assets=1000 * ratio, liability=1000.0, normal_cost=10.0, **shared
        )
        given, cut = indexation(terms, numbers, ratio=ratio, price_growth=0.025, smooth=smooth)
        return paid / 10 + 30 * given + 20 * cut

    inputs = {
        key: each
        for key, each in plain(pension_inputs(case)).items()
        if key.split("_")[0] in ("contribution", "indexation")
    }
    return inputs, jax.jit(jax.grad(value)), of_points(value, inputs)


@pytest.mark.prove
@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("ratio", [0.9, 1.01, 1.1, 1.24])
def test_every_number_of_the_rules(name, ratio):
    with jax.enable_x64(True):
        inputs, gradient, values = of_rules(name)
        adjoint = gradient(inputs, ratio)
        differences = slopes(lambda points: values(points, ratio), inputs)
        for key in inputs:
            # The rounded corners have a third derivative that jumps at their ends.
            np.testing.assert_allclose(adjoint[key], differences[key], 1e-5, 1e-7, err_msg=key)
