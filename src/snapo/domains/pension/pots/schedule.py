"""From the inputs of a fund of pots to the numbers that all its paths share."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.simulator import Schedule

from ..fund.schedule import Period, Terms, added_rate, basis_log_bond, make_schedule
from ..market.state import log_factor
from ..records.case import PensionCase
from ..records.inputs import use
from ..records.pots import Pots
from .members import cohorts
from .sharing import Reserve


class PotTerms(NamedTuple):
    """The whole horizon: the `fund`'s terms, the `reserve`'s rules, `fill` the share of
    contributions that it takes, `pots` [C] and `kept` (the reserve) now, `level` of pots over
    annuities now; `last` [C, J] the cohorts' payments at the horizon."""

    fund: Terms
    reserve: Reserve
    fill: Array
    pots: Array
    kept: Array
    level: Array
    last: Array

    @property
    def assets(self) -> Array:
        return self.fund.assets

    @property
    def liability(self) -> Array:
        return self.fund.liability


class PotPeriod(NamedTuple):
    """One step: the `fund`'s period; of the cohorts the payments on the nodes before and after it
    [C, J], `shape_after` [J] of the curve then, the `benefit` [C] of the step, the shares of
    `payroll` [C], `drawing` [C] at its end, `protection` and `exposure` [C]; `unwound` the growth
    of an annuity that is not the curve's but the addition's to it."""

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


def known(case: PensionCase) -> Pots:
    """The pots of a case that has them."""
    assert case.pots is not None
    return case.pots


def pot_schedule(case: PensionCase, inputs: dict[str, Any]) -> Schedule:
    """All numbers that do not depend on the path."""
    fund, given = make_schedule(case, inputs), known(case)
    terms, steps = fund.constants, fund.steps
    people = cohorts(case, inputs, basis_log_bond(case, inputs))
    shape = jnp.concatenate([steps.shape, terms.last_shape[None]])
    annuity = worth(terms, people.value[0], shape[0], terms.market.start)
    kept = use(inputs, given.reserve) * terms.assets
    level = (terms.assets - kept) / jnp.sum(annuity)
    unwound = jnp.zeros(case.steps)
    if case.liability.basis != "risk-free":
        years = np.arange(case.steps + 1) * case.step
        unwound = jnp.diff(added_rate(case, inputs, years) * years)
    constants = PotTerms(
        fund=terms,
        reserve=Reserve(
            *(use(inputs, each) for each in (given.fill_return, given.release, given.largest))
        ),
        fill=use(inputs, given.fill_contribution),
        pots=level * annuity,
        kept=kept,
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
        protection=use(inputs, given.protection),
        exposure=use(inputs, given.exposure),
        unwound=unwound,
    )
    return Schedule(constants, periods)


def worth(terms: Terms, value: Float[Array, "C J"], shape: Array, market) -> Float[Array, " C"]:
    """Each cohort's annuity at a market."""
    return value @ jnp.exp(log_factor(terms.market, shape, market))
