"""The numbers that all paths of a fund of pots share, from its inputs."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.simulator import Schedule

from ..fund.schedule import FundTerms, Period, added_rate, basis_log_bond, make_schedule
from ..market.state import log_factor
from ..people.cash_flows import horizon, project
from ..people.liability import forward_discount, on_nodes
from ..people.lives import Lives, drawing, working
from ..records.case import PensionModel
from ..records.inputs import use
from ..records.pots import Pots
from .sharing import Reserve


class Cohorts(NamedTuple):
    """The data of the cohorts that all paths share. The leading axis T + 1 is time: t means before
    step t.

    - `value` [T+1, C, J]: forward value of each cohort's payments on the nodes, for pensions as
      they were earned at time 0; `benefit` [T+1, C]: the payments in step t.
    - `payroll` [T+1, C]: each cohort's share of the salaries; zeros where no one works.
    - `drawing` [T+1, C]: 1 if the pension is in payment.
    """

    value: Array
    benefit: Array
    payroll: Array
    drawing: Array


def cohorts(case: PensionModel, inputs: dict[str, Any], log_bond: Array) -> Cohorts:
    """The cohorts of a case. `log_bond` as in `people.liability.people`, under ready-made scenarios
    without the curve."""
    streams = project(case, inputs, log_bond).streams
    assert streams is not None
    assert case.members is not None
    lives, steps, count = streams.lives, case.steps, horizon(case)
    paid = streams.held[:, None] * streams.unit
    flow = jnp.zeros((len(lives.age), count)).at[streams.group].add(paid)
    flow = jnp.where(np.arange(count) < count - steps, flow, 0.0)
    discount = forward_discount(case, log_bond)
    value = jax.vmap(lambda item: on_nodes(case, item, discount))(flow)
    return Cohorts(
        value=jnp.swapaxes(value, 0, 1),
        benefit=flow[:, : steps + 1].T,
        payroll=_payroll(case, inputs, lives),
        drawing=jnp.asarray(drawing(case, lives, steps + 1).T > 0, float),
    )


def _payroll(case: PensionModel, inputs: dict[str, Any], lives: Lives) -> Array:
    members, steps = case.members, case.steps + 1
    assert members is not None
    item = use(inputs, members.number) * use(inputs, members.salary)
    earned = item[:, None] * working(case, lives, steps) * lives.alive[:, :steps]
    total = earned.sum(0)
    return (earned / jnp.where(total > 0, total, 1.0)).T


class PotTerms(NamedTuple):
    """The numbers of the whole horizon: the `fund`'s terms; the rules of the `reserve`; `fill`:
    the share of contributions that is paid into the reserve; `pots` [C] and `start_reserve`: pots
    and reserve at the start; `level`: pots divided by annuities at the start; `last` [C, J]: the
    cohorts' payments at the horizon."""

    fund: FundTerms
    reserve: Reserve
    fill: Array
    pots: Array
    start_reserve: Array
    level: Array
    last: Array

    @property
    def assets(self) -> Array:
        return self.fund.assets

    @property
    def liability(self) -> Array:
        return self.fund.liability


class PotPeriod(NamedTuple):
    """One step: the `fund`'s period; for the cohorts the payments on the nodes before and after it
    [C, J], the `benefit` [C] of the step, the shares of `payroll` [C], whether they are `drawing`
    pensions [C] at its end, `protection` and `exposure` [C]. `shape_after` [J]: the shape of the
    curve after the step; `unwound`: the part of an annuity's growth that is due to the addition to
    the curve."""

    fund: Period
    value: Array
    value_after: Array
    shape_after: Array
    benefit: Array
    payroll: Array
    drawing: Array
    protection: Array
    exposure: Array
    unwound: Array


def pots_of(case: PensionModel) -> Pots:
    """The pots of a case that has them."""
    assert case.pots is not None
    return case.pots


def pot_schedule(case: PensionModel, inputs: dict[str, Any]) -> Schedule:
    """All numbers that do not depend on the path."""
    fund, values = make_schedule(case, inputs), pots_of(case)
    terms, steps = fund.constants, fund.steps
    log_bond = basis_log_bond(case, inputs, curve=case.scenarios is None)
    people = cohorts(case, inputs, log_bond)
    shape = jnp.concatenate([steps.shape, terms.last_shape[None]])
    annuity = annuity_values(terms, people.value[0], shape[0], terms.market.start)
    start_reserve = use(inputs, values.reserve) * terms.assets
    level = (terms.assets - start_reserve) / jnp.sum(annuity)
    unwound = jnp.zeros(case.steps)
    if case.liability.basis != "risk-free":
        years = np.arange(case.steps + 1) * case.step
        unwound = jnp.diff(added_rate(case, inputs, years) * years)
    constants = PotTerms(
        fund=terms,
        reserve=Reserve(
            *(use(inputs, item) for item in (values.fill_return, values.release, values.largest))
        ),
        fill=use(inputs, values.fill_contribution),
        pots=level * annuity,
        start_reserve=start_reserve,
        level=level,
        last=people.value[-1],
    )
    periods = PotPeriod(
        fund=steps,
        value=people.value[:-1],
        value_after=people.value[1:],
        shape_after=shape[1:],
        benefit=people.benefit[:-1],
        payroll=people.payroll[:-1],
        drawing=people.drawing[1:],
        protection=use(inputs, values.protection),
        exposure=use(inputs, values.exposure),
        unwound=unwound,
    )
    return Schedule(constants, periods)


def annuity_values(
    terms: FundTerms, value: Float[Array, "C J"], shape: Array, market
) -> Float[Array, " C"]:
    """The value of each cohort's annuity in a market, [C]."""
    return value @ jnp.exp(log_factor(terms.market, shape, market))
