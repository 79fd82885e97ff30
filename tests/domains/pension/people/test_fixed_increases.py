"""Fixed increases against payments without them, and the derivative by their rate."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.domains.pension.people_cases import cash_flows, given, indexing, people_case, plan

from snapo.domains.pension.fund.schedule import basis_log_bond
from snapo.domains.pension.people.cash_flows import horizon, project
from snapo.domains.pension.people.fixed_increases import due
from snapo.domains.pension.records.inputs import pension_inputs
from snapo.problem.inputs import plain
from snapo.problem.record.either import with_numpy

RATE = 0.03


def with_increases(rate=RATE, **changes):
    rule = indexing("fixed", month=7, rate=given("indexation_rate", rate))
    return people_case(plan=plan(indexation=rule), **changes)


@with_numpy
def flows(case, inputs=None):
    inputs = plain(pension_inputs(case)) if inputs is None else inputs
    return project(case, inputs, basis_log_bond(case, inputs))[:2]


def dates(case, count):
    """Dates of increase before each step."""
    return np.concatenate([[0], np.cumsum(due(case, count))[:-1]])


def test_dates_are_those_of_the_month():
    case = with_increases()
    found = np.flatnonzero(due(case, 36))
    assert np.diff(found).tolist() == [12, 12]
    assert (case.start_month + found[0]) % 12 + 1 == 7
    assert due(replace(case, step=1.0), 3).all()


@pytest.mark.prove
@pytest.mark.parametrize("members", [True, False])
def test_payments_grow_by_the_rate_at_every_date(members):
    given_flows = {} if members else {"members": None, "mortality": None}
    if not members:
        given_flows["cash_flows"] = cash_flows([100.0, 50.0], [3, 40])
    case = with_increases(**given_flows)
    level = replace(case, plan=replace(case.plan, indexation=indexing("none")))
    (accrued, fresh), (plain_accrued, plain_fresh) = flows(case), flows(level)
    n = dates(case, horizon(case))
    assert accrued == pytest.approx(plain_accrued * (1 + RATE) ** n, rel=1e-13)
    since = n - n[: case.steps, None]
    assert fresh == pytest.approx(plain_fresh * (1 + RATE) ** since, rel=1e-13)
    assert accrued.sum() > 1.2 * plain_accrued.sum() or not members


@pytest.mark.prove
def test_the_liability_has_its_derivative_by_the_rate():
    case = with_increases()
    inputs = plain(pension_inputs(case))
    assert "indexation_rate" in inputs
    with jax.enable_x64(True):
        count = horizon(case)

        @jax.jit
        def liability(rate):
            moved = {name: jnp.asarray(v) for name, v in inputs.items()} | {"indexation_rate": rate}
            log_bond = basis_log_bond(case, moved)
            return project(case, moved, log_bond).accrued @ jnp.exp(log_bond[:count])

        at = inputs["indexation_rate"]
        slope = np.asarray(jax.jit(jax.grad(lambda rate: liability(rate)))(at))
        up, down = float(liability(at + 1e-6)), float(liability(at - 1e-6))
    assert slope.item() == pytest.approx((up - down) / 2e-6, rel=1e-7)
