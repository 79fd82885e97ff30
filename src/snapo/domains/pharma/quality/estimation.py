"""Fits kinetic numbers to measured batches by weighted least squares, and tests the fit.

Residuals are (model - measured) / error, and their derivatives are those of the model. With errors
known as standard deviations the covariance is (J^T J)^-1 (Bard, Nonlinear Parameter Estimation,
1974); intervals use Student's t with n - p degrees of freedom, which is slightly conservative. If
chi^2 is significantly too large, or the errors are known only up to a factor, the covariance is
multiplied by chi^2 / (n - p), to agree with the residuals.

The search begins at the numbers of the case and at points of a Halton sequence within the bounds.
Other minima are reported if their chi^2 is as good as the best one and they are not connected to
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import chdtrc, gammaincinv, stdtrit

from snapo.study.chapter import Floats, Number

from ..derivatives.mode import of_method
from ..derivatives.sensitivities import entry_name
from .records import Estimation, Experiment

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess

NOTABLE = 0.3  # of a direction's length: a number that belongs to it
MISFIT = 1e-3  # tail of chi^2 below which the model does not describe the data
SAME = 1e-9  # of half of chi^2: minima that differ by less are equally good
AT_BOUND = 1e-5  # of the room between its bounds: so near a number is at one of them


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """The fitted numbers, in the domain's units; P numbers, n measurements.

    - `values`: [P], with the confidence interval from `low` to `high`; NaN if not identified.
    - `at_bound`: [P] "low" or "high" if a number is at that bound, else ""; its interval is then
      one-sided, and the other intervals hold it there.
    - `covariance`, `correlation`: [P, P] of the fitted variables (of the logarithm if this is
      fitted); 0 for numbers at a bound. `scale`: the factor on (J^T J)^-1.
    - `residuals`: [n], in standard deviations of the measurement; `chi2`: their sum of squares,
      of `freedom` = n - P degrees of freedom; `tail`: its p-value, NaN if only the ratios of
      errors are known. `measured`, `fitted_values`: [n].
    - `condition`: ratio of the largest to the smallest singular value, with variables scaled by
      their bounds.
    - `unidentified`: directions that the data do not determine, as text.
    - `minima`: [M, P] other numbers that fit as well, with their `minima_chi2`, [M]; `starts`: the
      number of starting points.
    """

    names: tuple[str, ...]
    values: Floats
    low: Floats
    high: Floats
    at_bound: tuple[str, ...]
    covariance: Floats
    correlation: Floats
    scale: Number
    residuals: Floats
    measured: Floats
    fitted_values: Floats
    chi2: Number
    freedom: int
    tail: Number
    condition: Number
    unidentified: tuple[str, ...]
    converged: bool
    message: str
    minima: Floats
    minima_chi2: Floats
    starts: int


def fit(process: "PharmaProcess", estimation: Estimation) -> ParameterFit:
    """Least squares within the bounds, starting from the case's numbers and from other points."""
    model = model_of(process, estimation, estimation.experiments)
    log = np.array(estimation.logarithm)
    low, high = (variables_of(np.array(x), log) for x in (estimation.low, estimation.high))
    local = np.array([
        process.inputs[name][entry] for name, entry in zip(estimation.inputs, estimation.entries)
    ])  # fmt: skip
    error = np.concatenate([experiment.error for experiment in estimation.experiments])
    measured = np.concatenate([item.value for item in estimation.experiments])

    residual = jax.jit(lambda x: (model(numbers_of(x, log)) - measured) / error)
    slope = jax.jit(of_method(process.case.numerics.method)(residual))
    from scipy.stats import qmc  # late: it takes a second to load

    shares = qmc.Halton(len(local), scramble=False).random(estimation.starts)[1:]
    begins = [variables_of(local, log), *(low + shares * (high - low))]
    searched = []
    with jax.enable_x64(True):
        for start in begins:
            first = np.asarray(residual(start))
            if np.isfinite(first).all():
                searched.append(_searched(residual, slope, start, low, high))
            elif not searched:
                at = int(np.argmin(np.isfinite(first)))
                raise ArithmeticError(
                    f"the model has no value for measurement {at + 1} at the numbers of the case"
                )
    lowest = min(value.cost for value in searched)
    # Of equal ones the first: that of the case's numbers, where it is among them.
    result = next(each for each in searched if each.cost <= lowest + SAME * max(lowest, 1.0))
    names = tuple(
        entry_name(process.case, *each) for each in zip(estimation.inputs, estimation.entries)
    )
    resolved = result.fun * error + measured
    others = _others(result, searched, estimation)
    judged = _judged(result, others, measured, resolved, low, high, names, estimation)
    return replace(judged, starts=len(searched))


def _searched(residual, slope, start, low, high) -> OptimizeResult:
    """The minimum that a search from one point reaches."""
    return least_squares(
        lambda x: np.asarray(residual(x)),
        start,
        jac=lambda x: np.asarray(slope(x)),  # pyright: ignore[reportArgumentType]
        bounds=(low, high),
        x_scale=high - low,
        xtol=1e-13,
        ftol=1e-13,
        gtol=1e-12,
        max_nfev=200,
    )


def _others(result, searched, estimation: Estimation) -> list[OptimizeResult]:
    """Minima that fit as well as the best one and are separate from it. A minimum that the
    quadratic approximation at the best one connects with it is the same minimum, or differs along a
    direction that the data leave free."""
    count, size = result.jac.shape
    scale = _scale(2 * result.cost, count - size, estimation.errors)
    room = 2 * gammaincinv(size / 2, estimation.level) * scale
    selected = [result]
    for item in sorted(searched, key=lambda one: one.cost):
        valid = item.status > 0 and 2 * (item.cost - result.cost) <= room
        if valid and all(np.sum((one.jac @ (item.x - one.x)) ** 2) > room for one in selected):
            selected.append(item)
    return selected[1:]


def _scale(chi2: float, freedom: int, errors: str) -> float:
    """The factor on the covariance of known errors."""
    freedom = max(freedom, 1)
    if errors == "relative" or chdtrc(freedom, chi2) < MISFIT:
        return chi2 / freedom
    return 1.0


def variables_of(values: np.ndarray, log: np.ndarray) -> np.ndarray:
    """[P] the fitted variables of numbers: the logarithm of those with `log`."""
    return np.where(log, np.log(np.where(log, values, 1.0)), values)


def numbers_of(variables, log: np.ndarray):
    """[P] the numbers of fitted variables; plain JAX."""
    return jnp.where(log, jnp.exp(jnp.where(log, variables, 0.0)), variables)


def _numbers(variables: np.ndarray, log: np.ndarray) -> np.ndarray:
    """The numbers of fitted variables in NumPy."""
    return np.where(log, np.exp(np.where(log, variables, 0.0)), variables)


def model_of(process: "PharmaProcess", estimation: Estimation, experiments: Sequence[Experiment]):
    """[P] fitted numbers -> [n] the model's values of the measurements, by experiment."""
    resolved = tuple(zip(estimation.inputs, estimation.entries))

    def run(numbers):
        results = []
        for experiment in experiments:
            changed = tuple((name, entry) for name, entry, _ in experiment.settings)
            values = jnp.array([value for *_, value in experiment.settings])
            inputs = {name: jnp.asarray(value) for name, value in process.inputs.items()}
            if changed:
                inputs = process.shifted(values, changed, inputs)
            inputs = process.shifted(numbers, resolved, inputs)
            results.append(_observed(process, inputs, experiment))
        return jnp.concatenate(results)

    return run


def _observed(process: "PharmaProcess", inputs, experiment):
    """[n] states at their times, computed unit by unit and returned in the order of the data."""
    units = [state.partition(".")[0] for state in experiment.state]
    result = jnp.zeros(len(units))
    for unit in dict.fromkeys(units):
        at = np.array([i for i, item in enumerate(units) if item == unit])
        states = tuple(experiment.state[i].partition(".")[2] for i in at)
        result = result.at[at].set(process.observe(inputs, unit, states, experiment.time[at]))
    return result


def _judged(result, others, measured, resolved, low, high, names, estimation) -> ParameterFit:
    """The covariance if the data identify all numbers; otherwise the free directions as text."""
    log, width = np.array(estimation.logarithm), high - low
    count, size = result.jac.shape
    chi2, freedom = 2 * float(result.cost), count - size
    scale = _scale(chi2, freedom, estimation.errors)
    _, singular, right = np.linalg.svd(result.jac * width, full_matrices=False)
    # One standard deviation along a direction as a share of the bounds: above 1 it is unidentified.
    loose = singular < 1
    unidentified = tuple(_direction(right[i], names) for i in np.flatnonzero(loose))
    free = (np.abs(right[loose]) > NOTABLE).any(0) if loose.any() else np.zeros(size, bool)
    at_low, at_high = (result.x - low) / width < AT_BOUND, (high - result.x) / width < AT_BOUND
    inside = ~(at_low | at_high)
    complete = _covariance(result.jac, width)
    covariance = np.zeros((size, size))
    if inside.any():
        covariance[np.ix_(inside, inside)] = scale * _covariance(
            result.jac[:, inside], width[inside]
        )
    deviation = np.sqrt(np.diag(covariance))
    half = stdtrit(max(freedom, 1), (1 + estimation.level) / 2) * deviation
    endpoints = [result.x - half, result.x + half]
    # At a bound chi^2 rises from the start: to where it is larger by t^2, one-sided.
    gradient = np.abs(result.jac.T @ result.fun)
    maximum = scale * stdtrit(max(freedom, 1), estimation.level) ** 2
    variance = np.maximum(np.diag(complete), 1e-300)
    reach = variance * (np.sqrt(gradient**2 + maximum / variance) - gradient)
    endpoints[0] = np.where(
        at_low, low, np.where(at_high, np.maximum(high - reach, low), endpoints[0])
    )
    endpoints[1] = np.where(
        at_high, high, np.where(at_low, np.minimum(low + reach, high), endpoints[1])
    )
    lowest, highest = (_numbers(x, log) for x in endpoints)
    available = deviation > 0
    sizes = np.where(available, deviation, 1.0)
    correlation = np.where(
        np.outer(available, available), covariance / np.outer(sizes, sizes), np.eye(size)
    )
    tail = np.nan if estimation.errors == "relative" else chdtrc(max(freedom, 1), chi2)
    return ParameterFit(
        names=names,
        values=_numbers(result.x, log),
        low=np.where(free, np.nan, lowest),
        high=np.where(free, np.nan, highest),
        at_bound=tuple(
            "low" if one else "high" if other else "" for one, other in zip(at_low, at_high)
        ),
        covariance=covariance,
        correlation=correlation,
        scale=scale,
        residuals=result.fun,
        measured=measured,
        fitted_values=resolved,
        chi2=chi2,
        freedom=freedom,
        tail=float(tail),
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf"),
        unidentified=unidentified,
        converged=result.status > 0,
        message=str(result.message),
        minima=np.array([_numbers(item.x, log) for item in others]).reshape(-1, size),
        minima_chi2=np.array([2 * float(entry.cost) for entry in others]),
        starts=1,
    )


def _covariance(jacobian: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(J^T J)^-1 along the directions that the data narrow."""
    _, singular, right = np.linalg.svd(jacobian * width, full_matrices=False)
    available = np.where(singular < 1, 0.0, 1 / np.maximum(singular, 1.0) ** 2)
    return (right.T * available) @ right * np.outer(width, width)


def _direction(row: np.ndarray, names: tuple[str, ...]) -> str:
    """The numbers that move together along a direction that the data leave free."""
    selected = [names[i] for i in np.flatnonzero(np.abs(row) > NOTABLE)]
    if len(selected) == 1:
        return f"{selected[0]} is not identified by these data"
    return f"only a combination of {', '.join(selected)} is identified by these data"
