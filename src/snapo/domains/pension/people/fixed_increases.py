"""Fixed increases are promised unconditionally, so they are part of the payments.

At the end of every step that ends on the date of indexation, pensions in payment grow by the rate
of `Indexation`. Rights before payment grow equally, or by the rates of a `Revaluation`: one for
deferred members until their pension begins, one for actives in service.
"""

from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.case import PensionModel
from ..records.inputs import use
from .lives import Lives


class GrownPensions(NamedTuple):
    """The size in each step of a right that was 1 at time 0: `member` [C, N] of a member, `payment`
    [N] of a pension that has been in payment all the time."""

    member: Array
    payment: Array


def due(case: PensionModel, count: int) -> np.ndarray:
    """Whether a step ends on the date of indexation, [count]; yearly steps always do."""
    if round(1 / case.step) == 1:
        return np.ones(count, bool)
    return (case.start_month + np.arange(count)) % 12 + 1 == case.plan.indexation.month


def in_payment(case: PensionModel, inputs: dict[str, Any], count: int) -> Float[Array, " count"]:
    """The size in each step of a pension in payment that was 1 at time 0 [count]; always 1 without
    fixed increases."""
    rule = case.plan.indexation
    if rule.kind != "fixed" or rule.rate is None:
        return xp.ones(count)
    return (1 + use(inputs, rule.rate)) ** xp.asarray(_dates(case, count), float)


def grown(
    case: PensionModel, inputs: dict[str, Any], lives: Lives, drawn: Array
) -> GrownPensions | None:
    """The growth of all rights; None if nothing grows by a fixed rate.

    **Arguments:**

    - `drawn`: [C, N] above 0 if a member's pension is in payment.
    """
    apart, count = case.plan.revaluation, drawn.shape[1]
    payment = in_payment(case, inputs, count)
    if apart is None:
        if case.plan.indexation.kind != "fixed":
            return None
        return GrownPensions(xp.broadcast_to(payment, drawn.shape), payment)
    dates = xp.asarray(_dates(case, count), float)
    active, deferred = ((1 + use(inputs, rate)) ** dates for rate in (apart.active, apart.deferred))
    before = xp.where(lives.earning[:, None], active, deferred)
    # The first step of payment; a pension that never begins waits to the end.
    waits = count - xp.sum(xp.cumsum(drawn > 0, axis=1) > 0, axis=1)
    first = xp.minimum(waits, count - 1)
    started = (xp.take_along_axis(before, first[:, None], 1)) / payment[first][:, None]
    return GrownPensions(
        xp.where(np.arange(count) < waits[:, None], before, started * payment), payment
    )


def _dates(case: PensionModel, count: int) -> np.ndarray:
    """[count] how many dates of increase lie before each step."""
    return np.concatenate([[0], np.cumsum(due(case, count))[:-1]])
