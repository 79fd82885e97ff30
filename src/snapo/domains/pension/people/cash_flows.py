"""Expected payments by step: for rights accrued by now, and for the accrual of every later step.

A stream is a payment profile that scales with rights: `unit` [K, N] money in each step per unit of
yearly pension, times `held` [K] rights at time 0, or `accrual` [K, T] rights per step. With a
spouse's pension each group of members has three streams: the member's pension; the spouse's pension
as if the member were dead; and, with a minus sign, the spouse's pension while both live. Rights
belong to the member, so the accrual of a step belongs to the members who are alive in it.

If rights before payment grow by different rates, a spouse's pension depends on when the member
died. The second stream then contains the rights that past deaths have left and those that a death
now would leave. A fourth stream removes members who died before an accrual. The response to the
mortality factor (`longevity`) neglects that these rights depend on the member's life.

A payment is one step's share of the yearly pension. It is made at the start ("advance") or the end
("arrears") of a step to those alive at that time. Pensions of active and deferred members begin at
the retirement age: the step that contains this age has work and accrual before it, and pays the
pension after it. A spouse's pension begins at the member's death, whenever that is. The accrual of
a step is paid from the next step on.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import added, updated, xp

from ..records.case import PensionModel
from ..records.inputs import is_empty, use
from ..records.people import PAYMENT_YEARS, SPOUSE, CashFlows, FundMembers
from .fixed_increases import grown, in_payment
from .lives import Lives, drawing, entrants, joined, present, share_before, working
from .mortality import log_survival, partner


class Streams(NamedTuple):
    """Payment profiles (see the module docstring), and the lives [K] on which each depends.
    `member`, `spouse`: [K] 1 if the profile depends on the life of the member, or of the spouse,
    in the group at position `group` [K] of `lives`.
    """

    unit: Array
    held: Array
    accrual: Array
    lives: Lives
    group: np.ndarray
    member: np.ndarray
    spouse: np.ndarray


class Projection(NamedTuple):
    """Expected payments; N is T plus the steps of `PAYMENT_YEARS`.

    - `accrued`: [N] money paid in each step for rights accrued by time 0.
    - `fresh`: [T, N], in row t the payments for the accrual of step t, per unit of wages divided by
      indexation.
    - `payroll`: [T+1] salaries of each step at wages of time 0.
    - `streams`: the components of these payments; None if the case has cash flows instead of
      members.
    """

    accrued: Array
    fresh: Array
    payroll: Array
    streams: Streams | None


def project(case: PensionModel, inputs: dict[str, Any], log_bond: Float[Array, " H"]) -> Projection:
    """Expected payments of a case; `log_bond` is that of `liability.people`, and only a case with
    cash flows needs it."""
    if case.cash_flows is not None:
        return _given(case, inputs, case.cash_flows, log_bond)
    if case.members is None:
        raise ValueError("members: a case has either members or cash flows.")
    count = horizon(case)
    lives = present(case, inputs, case.members, count)
    payroll = _payroll(case, inputs, case.members, lives)
    if case.plan.open and case.plan.accruing and case.steps * case.step > 1:
        lives = joined(lives, entrants(case, inputs, lives, count))
    streams = _streams(case, inputs, lives, case.members.status)
    # The accrual of step t is paid from step t + 1 on; no one lives longer than `PAYMENT_YEARS`.
    wait = np.arange(count) - np.arange(case.steps)[:, None]
    within = count - case.steps
    fresh = xp.where((wait > 0) & (wait < within), streams.accrual.T @ streams.unit, 0.0)
    accrued = xp.where(np.arange(count) < within, streams.held @ streams.unit, 0.0)
    return Projection(accrued, fresh, payroll, streams)


def reserved(case: PensionModel, inputs: dict[str, Any]) -> Array:
    """The reserve per unit of value of a payment: one plus the loading for expenses."""
    loading = case.liability.loading
    return xp.ones(()) if loading is None else 1 + use(inputs, loading)


def horizon(case: PensionModel) -> int:
    """The number N of steps whose payments are projected."""
    return case.steps + round(PAYMENT_YEARS / case.step)


def _streams(
    case: PensionModel, inputs: dict[str, Any], lives: Lives, status: np.ndarray
) -> Streams:
    plan, count, steps = case.plan, horizon(case), case.steps
    time, shift = np.arange(count), int(plan.timing == "arrears")
    drawn = drawing(case, lives, count)
    alive = lives.alive[:, shift : count + shift]
    growth = grown(case, inputs, lives, drawn)
    local, paid = case.step * drawn * alive, xp.asarray(case.step)
    rights = _accrual(case, inputs, lives)
    if growth is not None:
        local, paid = local * growth.member, paid * growth.payment
        # A right of step t has not grown before it was there.
        rights = rights / growth.member[:, :steps]
    groups = np.arange(len(lives.age))
    one, none = np.ones(len(groups)), np.zeros(len(groups))
    if is_empty(plan.spouse_share) or is_empty(plan.married_share):
        return Streams(local, lives.pension, rights, lives, groups, one, none)
    entered = xp.ones(len(groups) - len(status), bool)
    insured = xp.concatenate([xp.asarray(status) != SPOUSE, entered])
    share = use(inputs, plan.spouse_share) * use(inputs, plan.married_share) * insured
    widowed = _partner_alive(case, inputs, lives)[:, shift : count + shift]
    widowed = share[:, None] * widowed * (time >= lives.entry[:, None]) * paid
    if growth is None or plan.revaluation is None:
        return Streams(
            unit=xp.concatenate([local, widowed, -widowed * alive]),
            held=xp.tile(lives.pension, 3),
            accrual=xp.concatenate([rights, rights * lives.alive[:, :steps], rights]),
            lives=lives,
            group=np.tile(groups, 3),
            member=np.concatenate([one, none, one]),
            spouse=np.concatenate([none, one, one]),
        )
    ratio = growth.member / growth.payment
    left, before = _left(lives.alive, ratio, shift), alive * ratio
    return Streams(
        unit=xp.concatenate(
            [local, widowed * (left[:, shift : count + shift] + before), -widowed * before, widowed]
        ),
        held=xp.concatenate([xp.tile(lives.pension, 3), 0 * lives.pension]),
        accrual=xp.concatenate([rights, rights, rights, -rights * left[:, :steps]]),
        lives=lives,
        group=np.tile(groups, 4),
        member=np.concatenate([one, none, one, none]),
        spouse=np.concatenate([none, one, one, one]),
    )


def _left(alive: Array, ratio: Array, shift: int) -> Float[Array, "C N+1"]:
    """The rights that deaths in all steps until a time have left, as pensions that were in payment
    from time 0. A death in a step leaves the right of the step in which the pension is first paid.

    **Arguments:**

    - `ratio`: [C, N] of a member's right over a pension in payment.
    """
    deaths = alive[:, :-1] - alive[:, 1:]
    count = deaths.shape[1]
    at = np.minimum(np.arange(1, count + 1) - shift, count - 1)
    total = xp.cumsum(deaths * ratio[:, at], axis=1)
    return xp.concatenate([xp.zeros_like(total[:, :1]), total], axis=1)


def _accrual(case: PensionModel, inputs: dict[str, Any], lives: Lives) -> Float[Array, "C T"]:
    """Yearly pension that each step accrues per member of entry, who must be alive for it."""
    plan, steps = case.plan, case.steps
    if not plan.accruing:
        return xp.zeros((len(lives.age), steps))
    since = (np.arange(steps) - lives.entry[:, None]) * case.step
    counts = share_before(plan.max_service, lives.service[:, None] + since, case.step)
    rate = use(inputs, plan.accrual_rate) * case.step
    return rate * lives.base[:, None] * xp.minimum(working(case, lives, steps), counts)


def _partner_alive(case: PensionModel, inputs: dict[str, Any], lives: Lives) -> Array:
    """Survival of the spouses from the entry of the members, as `Lives.alive`."""
    count = horizon(case)
    sex, age = partner(case.plan, lives.sex, lives.age)
    path = log_survival(case, inputs, sex, age, count)
    start = path[np.arange(len(age)), lives.entry][:, None]
    since = np.arange(count + 1) >= lives.entry[:, None]
    return xp.exp(xp.where(since, path - start, 0.0))


def _payroll(
    case: PensionModel, inputs: dict[str, Any], members: FundMembers, lives: Lives
) -> Float[Array, " T+1"]:
    """Salaries per step at wages of time 0: as actives leave, or constant in an open plan."""
    steps = case.steps + 1
    item = use(inputs, members.number) * use(inputs, members.salary) * case.step
    at_work = working(case, lives, steps) * lives.alive[:, :steps]
    paid = item @ at_work
    return xp.full(steps, paid[0]) if case.plan.open else paid


def _given(
    case: PensionModel, inputs: dict[str, Any], flows: CashFlows, log_bond: Array
) -> Projection:
    """The actuary's vector. The accrual of a step is paid like that vector, seen one step earlier.
    It is scaled so that the normal cost of step 0 on the initial curve is that of the case.
    """
    count, steps = horizon(case), case.steps
    amount = use(inputs, flows.amount)
    accrued = added(xp.zeros(count), flows.step, amount)
    growth = in_payment(case, inputs, count)
    payroll = xp.full(steps + 1, use(inputs, flows.salary) * case.step)
    none = xp.zeros((steps, count))
    if not case.plan.accruing or is_empty(flows.normal_cost):
        return Projection(accrued * growth, none, payroll, None)
    shift = int(case.plan.timing == "arrears")
    discount = xp.exp(log_bond[shift : count + shift])
    profile = updated(accrued, 0, 0.0)
    value = reserved(case, inputs) * ((profile * growth) @ discount)
    profile = profile * use(inputs, flows.normal_cost) / xp.where(value > 0, value, 1.0)
    later = np.arange(count) - np.arange(steps)[:, None]
    fresh = xp.where(later > 0, profile[np.maximum(later, 0)], 0.0)
    fresh = fresh * growth / growth[:steps, None]
    return Projection(accrued * growth, fresh, payroll, None)
