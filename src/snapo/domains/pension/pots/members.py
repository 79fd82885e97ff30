"""The cohorts of a fund of pots: the payments of each, valued on the curve of every path.

A cohort's measure is its `annuity`: the expected payments of the pensions that its members had
earned at time 0. A pot worth x times that annuity pays x times these pensions, for life.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..people.cash_flows import horizon, project
from ..people.liability import forward_discount, on_nodes
from ..people.lives import Lives, drawing, working
from ..records.case import PensionCase
from ..records.inputs import use


class Cohorts(NamedTuple):
    """What all paths share. Leading axis T + 1: at time t, before step t.

    - `value` [T+1, C, J]: forward value of each cohort's payments on the nodes, of pensions as they
      were earned at time 0; `benefit` [T+1, C]: those paid in step t.
    - `payroll` [T+1, C]: each cohort's share of the salaries; zeros where nobody works.
    - `drawing` [T+1, C]: 1 where the pension is in payment.
    """

    value: Array
    benefit: Array
    payroll: Array
    drawing: Array


def cohorts(case: PensionCase, inputs: dict[str, Any], log_bond: Array) -> Cohorts:
    """The cohorts of a case; `log_bond` as in `people.liability.people`."""
    streams = project(case, inputs, log_bond).streams
    assert streams is not None
    assert case.members is not None
    lives, steps, count = streams.lives, case.steps, horizon(case)
    paid = streams.held[:, None] * streams.unit
    flow = jnp.zeros((len(lives.age), count)).at[streams.group].add(paid)
    flow = jnp.where(np.arange(count) < count - steps, flow, 0.0)
    discount = forward_discount(case, log_bond)
    value = jax.vmap(lambda each: on_nodes(case, each, discount))(flow)
    return Cohorts(
        value=jnp.swapaxes(value, 0, 1),
        benefit=flow[:, : steps + 1].T,
        payroll=_payroll(case, inputs, lives),
        drawing=jnp.asarray(drawing(case, lives, steps + 1).T > 0, float),
    )


def _payroll(case: PensionCase, inputs: dict[str, Any], lives: Lives) -> Array:
    members, steps = case.members, case.steps + 1
    assert members is not None
    each = use(inputs, members.number) * use(inputs, members.salary)
    earned = each[:, None] * working(case, lives, steps) * lives.alive[:, :steps]
    total = earned.sum(0)
    return (earned / jnp.where(total > 0, total, 1.0)).T
