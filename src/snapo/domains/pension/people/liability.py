"""The value of payments on every path: payments by date become weights on a few nodes, which the
curve of the path values.

Seen from time t a payment is due u steps later, between two nodes u1 <= u < u2. Its forward value
cf P0(t + u) / P0(t) is split linearly in u between the two nodes. A path multiplies the weights of
the nodes by the change of its curve since time 0 (1 if the curve followed the forwards). So the
liability depends on the initial curve payment by payment, and only the innovation of the curve is
interpolated.

The liability at t is Theta exp(-y) sum_j (accrued_tj + a fresh_tj) X_tj exp(-outlook_tj k). Theta
is cumulative indexation, y realised mortality, k the present mortality factor, and X the path's
factor of the node. a is the size of the rights accrued since time 0 divided by their size at
baseline wages: a' = (1 - mix) a + mix w / baseline, w = wages / Theta. The value of these rights is
then exact on the initial curve, and their profile over time is that of baseline wages.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.case import LeeCarter, PensionModel
from ..records.inputs import use
from ..records.people import PAYMENT_YEARS
from .cash_flows import Projection, Streams, horizon, project, reserved
from .lpi import Lpi
from .mortality import accumulate, partner, step_hazards


class Longevity(NamedTuple):
    """`decline` [T+1]: the fall of the logarithm of the value in step t per unit of k. `flow` [T+1,
    N]: the payments at baseline wages for rights accrued before t, multiplied by their responses to
    k from t on."""

    decline: Array
    flow: Array


def longevity(
    case: PensionModel, inputs: dict[str, Any], projection: Projection, log_bond: Float[Array, " H"]
) -> Longevity | None:
    """The response to the mortality factor at every time; None without the factor, or without
    members."""
    streams = projection.streams
    if case.lee_carter is None or streams is None:
        return None
    steps, count = case.steps, horizon(case)
    response = _response(case, inputs, case.lee_carter, streams)
    growth = use(inputs, case.inflation.real_wage_growth) * case.step
    gained = xp.exp(growth * xp.arange(steps)) * streams.accrual
    rights = streams.held[:, None] + accumulate(gained)
    shift = int(case.plan.timing == "arrears")
    at_payment = response[:, shift : count + shift]
    here = response[:, : steps + 1]
    flow = rights.T @ (streams.unit * at_payment) - (rights * here).T @ streams.unit
    value = streams.unit * xp.exp(log_bond[shift : count + shift])
    ahead = xp.cumsum(value[:, ::-1], axis=1)[:, ::-1]
    weight = rights[:, 1:] * ahead[:, 1 : steps + 1]
    total = weight.sum(0)
    fall = xp.sum(weight * (here[:, 1:] - here[:, :-1]), axis=0)
    return Longevity(xp.append(_mean(fall, total), 0.0), flow)


def _mean(total: Array, weight: Array) -> Array:
    """`total` divided by `weight`; 0 without a gradient where the weight is zero, or so small that
    its square, by which the derivative divides, is zero (payments to people who are surely dead).
    """
    due = weight > np.sqrt(np.finfo(weight.dtype).tiny)
    return xp.where(due, total / xp.where(due, weight, 1.0), 0.0)


def _response(
    case: PensionModel, inputs: dict[str, Any], factor: LeeCarter, streams: Streams
) -> Float[Array, "K N+1"]:
    """Sum of b h over the lives of each stream from time 0 to each time."""
    lives, count = streams.lives, horizon(case)
    loading = use(inputs, factor.loading)
    local = (lives.sex, lives.age, count, loading, lives.factor)
    member = accumulate(step_hazards(case, inputs, *local))
    response = xp.asarray(streams.member[:, None]) * member[streams.group]
    if not np.any(streams.spouse):
        return response
    sex, age = partner(case.plan, lives.sex, lives.age)
    other = accumulate(step_hazards(case, inputs, sex, age, count, loading))
    return response + xp.asarray(streams.spouse[:, None]) * other[streams.group]


class People(NamedTuple):
    """The numbers of the members that all paths share. The leading axis T + 1 is time: t means
    before step t.

    - `accrued`, `fresh` [T+1, J]: forward values on the nodes, including the loading for expenses,
      of rights accrued by time 0, and of rights accrued in steps before t at baseline wages.
      `accrual` [T+1, J]: the forward values of the accrual of step t, per unit of w (last row
      zeros). All are in money, at an indexation of 1.
    - `benefit`, `fresh_benefit` [T+1]: money paid in step t for `accrued` and for `fresh` rights.
    - `payroll` [T+1]: salaries of the step at wages of time 0. `expenses` [T+1]: money per step.
    - `baseline` [T+1]: the assumed w, exp(real wage growth).
    - `mix` [T+1]: the share of the accrual of step t in the value of fresh rights after this step.
    - `lpi`: the options in limited increases; None if they are not in the liability.
    - `decline` [T+1], `outlook` [T+1, J]: response of the logarithm of values to the mortality
      factor, see `longevity`; zeros without one.
    """

    accrued: Array
    fresh: Array
    accrual: Array
    benefit: Array
    fresh_benefit: Array
    payroll: Array
    expenses: Array
    baseline: Array
    mix: Array
    decline: Array
    outlook: Array
    lpi: Lpi | None = None


def nodes(step: float) -> np.ndarray:
    """The payment nodes [J] in steps from now, up to `PAYMENT_YEARS`; the first is 0.

    They are months 0, 1, 3, 6, then years 1, 1.5, 2, every year to 30, every second year to 50,
    and every fifth year after that.
    """
    item = round(1 / step)
    years = np.concatenate([np.arange(31), np.arange(32, 51, 2), np.arange(55, 101, 5)])
    if item == 1:
        return years
    return np.union1d([1, 3, 6, 18], years * item)


def people(
    case: PensionModel,
    inputs: dict[str, Any],
    log_bond: Float[Array, " H"],
    without_curve: Float[Array, " H"] | None = None,
) -> People:
    """Cash flows as weights on the nodes, for every time.

    **Arguments:**

    - `log_bond`: the logarithm of the discount factor at time 0 of a payment at time s * step,
      basis included, s = 0 ... T + `PAYMENT_YEARS` / step.
    - `without_curve`: under ready-made scenarios, the part of it other than the curve. Forward
      values then contain only this part, because each path discounts them on its own curve; shares
      and means still use `log_bond`.
    """
    steps, result = case.steps, project(case, inputs, log_bond)
    growth = use(inputs, case.inflation.real_wage_growth) * case.step
    baseline = xp.exp(growth * xp.arange(steps + 1))
    # Row t: rights accrued in steps before t; payments already made are left out.
    by_step = baseline[:steps, None] * result.fresh
    fresh = xp.concatenate([xp.zeros((1, by_step.shape[1])), xp.cumsum(by_step, axis=0)])
    discount = forward_discount(case, log_bond)
    complete = reserved(case, inputs)
    forward = discount if without_curve is None else forward_discount(case, without_curve)
    fresh_value = complete * on_nodes(case, fresh, discount)
    deaths = longevity(case, inputs, result, log_bond)
    here = np.arange(steps + 1)
    return People(
        accrued=complete * on_nodes(case, result.accrued, forward),
        fresh=fresh_value if without_curve is None else complete * on_nodes(case, fresh, forward),
        accrual=_with_row(complete * on_nodes(case, result.fresh, forward[:steps])),
        benefit=result.accrued[: steps + 1],
        fresh_benefit=fresh[here, here],
        payroll=result.payroll,
        expenses=xp.full(steps + 1, use(inputs, case.plan.expenses) * case.step),
        baseline=baseline,
        mix=_with_row(_mix(case, complete * by_step, fresh_value, discount)),
        decline=xp.zeros(steps + 1) if deaths is None else deaths.decline,
        outlook=_outlook(case, deaths, result, fresh, discount),
    )


def ahead(case: PensionModel) -> np.ndarray:
    """The positions [T+1, S] of the payments of steps t, t + 1, ... in a vector by step."""
    later = round(PAYMENT_YEARS / case.step)
    return np.arange(case.steps + 1)[:, None] + np.arange(later)


def paid_at(case: PensionModel, step: np.ndarray) -> np.ndarray:
    """The time, in steps, at which the payment of a step is made."""
    return step + (case.plan.timing == "arrears")


def forward_discount(case: PensionModel, log_bond: Array) -> Float[Array, "times S"]:
    """P0(payment) / P0(t) [T+1, S] of the payments of steps t, t + 1, ..."""
    now = log_bond[: case.steps + 1, None]
    return xp.exp(log_bond[paid_at(case, ahead(case))] - now)


def on_nodes(case: PensionModel, flow: Array, discount: Array) -> Float[Array, "times J"]:
    """Forward values on the nodes at every time, of payments [T+S], or of payments that differ by
    time [times, T+S]."""
    times = discount.shape[0]
    position = ahead(case)[:times]
    due = flow[position] if flow.ndim == 1 else flow[np.arange(times)[:, None], position]
    return (due * discount) @ xp.asarray(_split(case))


def _split(case: PensionModel) -> np.ndarray:
    """The share [S, J] of each payment ahead that goes to each node; rows add up to 1."""
    grid = nodes(case.step)
    due = paid_at(case, np.arange(round(PAYMENT_YEARS / case.step)))
    upper = np.minimum(np.searchsorted(grid, due, side="right"), len(grid) - 1)
    left = (grid[upper] - due) / (grid[upper] - grid[upper - 1])
    share = np.zeros((len(due), len(grid)))
    rows = np.arange(len(due))
    share[rows, upper - 1] = left
    share[rows, upper] = 1 - left
    return share


def _with_row(rows: Array) -> Array:
    """Rows of T steps and one of zeros for the horizon."""
    return xp.concatenate([rows, xp.zeros_like(rows[:1])])


def _mix(case: PensionModel, by_step: Array, fresh: Array, discount: Array) -> Float[Array, " T"]:
    """The value after step t of the accrual of this step, divided by that of all fresh rights."""
    steps, value = case.steps, fresh[1:].sum(1)
    due = by_step[np.arange(steps)[:, None], ahead(case)[1:]]
    local = xp.sum(due * discount[1:], axis=1)
    return _mean(local, value)


def _outlook(
    case: PensionModel,
    deaths: Longevity | None,
    projection: Projection,
    fresh: Array,
    discount: Array,
) -> Float[Array, "times J"]:
    """Mean response of each node's payments, weighted with their value; 0 if none is due."""
    if deaths is None:
        return xp.zeros((case.steps + 1, len(nodes(case.step))))
    flow = projection.accrued + fresh
    value = on_nodes(case, flow, discount)
    weighted = on_nodes(case, deaths.flow, discount)
    return _mean(weighted, value)
