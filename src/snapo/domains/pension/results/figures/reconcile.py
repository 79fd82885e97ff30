"""The actuary's figures from the model's cash flows and curve, before any simulation."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.lanes.program.in_numpy import in_numpy

from ...fund.schedule import basis_log_bond
from ...people.cash_flows import horizon, project, reserved
from ...people.liability import paid_at, people
from ...records.case import PensionCase
from ...records.market import MarketCurve

BASIS_POINT = 1e-4
EXACT = 1e-9  # relative: two ways to the same number, both in float64


class LiabilityFigures(NamedTuple):
    """The figures of a valuation report.

    - `liability`: value now on the case's basis, money. `duration`: years, minus d ln L / d rate
      for a parallel shift of continuous rates; `convexity`: years squared.
    - `key_rate`: [n] change of the liability, money, for +1 bp at each node of the nominal curve;
      `key_inflation` [k] the same of break-evens, `inflation01` their sum. 0 if the basis does
      not use that curve.
    - `cash_flow`: [S] expected payments of accrued rights by step, money, before indexation.
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
    """One check: the model's `own` figure, the one `given` (None: nothing to meet), the
    relative `error` and whether that is within the tolerance."""

    name: str
    own: float
    given: float | None
    error: float | None
    ok: bool | None


def figures(case: PensionCase, inputs: dict[str, Any]) -> LiabilityFigures:
    """All figures; `inputs` are plain arrays by name."""
    values = _with_curves(case, inputs)
    curves = case.curve.rate.name, case.inflation.break_even.rate.name
    slopes, (flow, discount, load) = _slopes(case)({name: values[name] for name in curves}, values)
    years = paid_at(case, np.arange(horizon(case))) * case.step
    value = flow * discount
    total = float(value.sum())
    prices = case.inflation.break_even.rate.name
    scale = total or 1.0
    return LiabilityFigures(
        liability=total,
        duration=float(value @ years) / scale,
        convexity=float(value @ years**2) / scale,
        key_rate=BASIS_POINT * slopes[case.curve.rate.name],
        key_inflation=BASIS_POINT * slopes[prices],
        inflation01=BASIS_POINT * float(slopes[prices].sum()),
        cash_flow=flow[: horizon(case) - case.steps] / float(load),
    )


@lru_cache(maxsize=4)  # stresses ask for the same case at other inputs
def _slopes(case: PensionCase) -> Callable[..., Any]:
    """Slopes of the liability by every number of the curves, with payments, discount factors and
    the loading for expenses."""
    case = replace(case, scenarios=None)

    def value(curves, others):
        values = others | curves
        both = payments(case, values)
        return jnp.dot(*both), (*both, reserved(case, values))

    return in_numpy(jax.grad(value, has_aux=True))


def check(
    case: PensionCase, inputs: dict[str, Any], available: LiabilityFigures | None = None
) -> list[ReconciledFigure]:
    """The actuary's liability and duration against the model's, then the model against itself;
    `available`: the figures, if they are known already."""
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
    plain = replace(case, scenarios=None)

    def split(values):
        return people(plain, values, basis_log_bond(plain, values)).accrued[0]

    value = float(in_numpy(split)(_with_curves(plain, inputs)).sum())
    lines.append(_line("liability on payment nodes", value, result.liability, EXACT))
    if case.liability.basis != "fixed" and _shifts_as_one(case.curve):
        parallel = -BASIS_POINT * result.duration * result.liability
        lines.append(_line("sum of key rates", float(result.key_rate.sum()), parallel, EXACT))
    return lines


def payments(case: PensionCase, inputs: dict[str, Any]) -> tuple[Array, Array]:
    """Expected payments by step [N], loading for expenses included, and their discount factors."""
    log_bond = basis_log_bond(case, inputs)
    flow = reserved(case, inputs) * project(case, inputs, log_bond).accrued
    return flow, jnp.exp(log_bond[paid_at(case, np.arange(horizon(case)))])


def _with_curves(case: PensionCase, inputs: dict[str, Any]) -> dict[str, Any]:
    """The inputs, with both curves in them even where the case holds them fixed."""
    curves = (case.curve.rate, case.inflation.break_even.rate)
    params = {curve.name: curve.values for curve in curves} | inputs
    return {name: np.asarray(values, np.float64) for name, values in params.items()}


def _shifts_as_one(curve: MarketCurve) -> bool:
    """Whether the same rise of all nodes raises all rates: not where they end in a fixed one."""
    return curve.extrapolation == "flat-forward"


def _line(
    name: str, local: float, values: float | None, tolerance: float | None
) -> ReconciledFigure:
    if values is None or tolerance is None:
        return ReconciledFigure(name, local, None, 0.0, True)
    error = (local - values) / abs(values) if values else local
    return ReconciledFigure(name, local, values, error, bool(abs(error) <= tolerance))
