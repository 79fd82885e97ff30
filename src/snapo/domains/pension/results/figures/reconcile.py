"""The figures of a valuation report, from the model's cash flows and curve, before any
simulation."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from snapo.problem.record.arrays import Array
from snapo.problem.record.either import jacobian, with_numpy, xp

from ...fund.schedule import basis_log_bond
from ...people.cash_flows import horizon, project, reserved
from ...people.liability import paid_at, people
from ...records.case import PensionCase
from ...records.market import MarketCurve

BASIS_POINT = 1e-4
EXACT = 1e-9  # relative: two ways to the same number, both in float64


class LiabilityFigures(NamedTuple):
    """The figures of a valuation report.

    - `liability`: the value now on the case's basis, in money. `duration`: minus d ln L / d rate
      for a parallel shift of continuous rates, in years; `convexity`: in years squared.
    - `key_rate`: [n] change of the liability, in money, for +1 bp at each node of the nominal
      curve; `key_inflation` [k]: the same for break-evens; `inflation01`: the sum of these. They
      are 0 if the basis does not use the curve.
    - `cash_flow`: [S] expected payments of accrued rights by step, in money, before indexation.
    """

    liability: float
    duration: float
    convexity: float
    key_rate: np.ndarray
    key_inflation: np.ndarray
    inflation01: float
    cash_flow: np.ndarray


@dataclass(frozen=True)
class ReconciledFigure:
    """One check: the model's `own` figure, the reference `given` (None if there is none), the
    relative `error`, and whether the error is within the tolerance (`ok`)."""

    name: str
    own: float
    given: float | None
    error: float | None
    ok: bool | None


def figures(case: PensionCase, inputs: dict[str, Any]) -> LiabilityFigures:
    """All figures; `inputs` are plain arrays by name."""
    values = _with_curves(case, inputs)
    flow, discount = with_numpy(payments)(case, values)
    paid = paid_at(case, np.arange(horizon(case)))
    years, value = paid * case.step, flow * discount
    total = float(value.sum())

    def log_discount(quotes, name):
        return basis_log_bond(case, values | {name: quotes})[paid]

    curves = case.curve.rate.name, case.inflation.break_even.rate.name
    # No payment of accrued rights depends on a curve, only its discount factor.
    rates, prices = (
        value @ jacobian(partial(log_discount, name=name), values[name]) for name in curves
    )
    scale = total or 1.0
    return LiabilityFigures(
        liability=total,
        duration=float(value @ years) / scale,
        convexity=float(value @ years**2) / scale,
        key_rate=BASIS_POINT * rates,
        key_inflation=BASIS_POINT * prices,
        inflation01=BASIS_POINT * float(prices.sum()),
        cash_flow=flow[: horizon(case) - case.steps] / float(with_numpy(reserved)(case, values)),
    )


def check(
    case: PensionCase, inputs: dict[str, Any], available: LiabilityFigures | None = None
) -> list[ReconciledFigure]:
    """The model's liability and duration against the actuary's, then against a second computation
    by the model; `available`: the figures, if they were computed before."""
    result = available or figures(case, inputs)
    request = case.reconcile
    lines = [
        _line(
            "liability",
            result.liability,
            request and request.liability,
            request and request.tolerance,
        ),
        _line(
            "duration", result.duration, request and request.duration, request and request.tolerance
        ),
    ]

    def split(values):
        return people(case, values, basis_log_bond(case, values)).accrued[0].sum()

    value = float(with_numpy(split)(_with_curves(case, inputs)))
    lines.append(_line("liability on payment nodes", value, result.liability, EXACT))
    if case.liability.basis != "fixed" and _shifts_as_one(case.curve):
        parallel = -BASIS_POINT * result.duration * result.liability
        lines.append(_line("sum of key rates", float(result.key_rate.sum()), parallel, EXACT))
    return lines


def payments(case: PensionCase, inputs: dict[str, Any]) -> tuple[Array, Array]:
    """Expected payments by step [N], loading for expenses included, and their discount factors."""
    log_bond = basis_log_bond(case, inputs)
    flow = reserved(case, inputs) * project(case, inputs, log_bond).accrued
    return flow, xp.exp(log_bond[paid_at(case, np.arange(horizon(case)))])


def _with_curves(case: PensionCase, inputs: dict[str, Any]) -> dict[str, Any]:
    """The inputs, with both curves in them even where the case holds them fixed."""
    curves = (case.curve.rate, case.inflation.break_even.rate)
    params = {curve.name: curve.values for curve in curves} | inputs
    return {name: np.asarray(values, np.float64) for name, values in params.items()}


def _shifts_as_one(curve: MarketCurve) -> bool:
    """Whether an equal rise of all nodes raises all rates equally: not if they converge to a fixed
    rate."""
    return curve.extrapolation == "flat-forward"


def _line(
    name: str, local: float, values: float | None, tolerance: float | None
) -> ReconciledFigure:
    if values is None or tolerance is None:
        return ReconciledFigure(name, local, None, 0.0, True)
    error = (local - values) / abs(values) if values else local
    return ReconciledFigure(name, local, values, error, bool(abs(error) <= tolerance))
