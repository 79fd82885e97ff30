"""Fits kinetic numbers to measured batches by weighted least squares, with intervals.

Residuals are (model - measured) / error, their derivatives the model's own. With errors known as
standard deviations the covariance is (J^T J)^-1 (Bard, Nonlinear Parameter Estimation, 1974);
intervals take Student's t with n - p degrees of freedom, which is a little wide.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from ..derivatives.sensitivities import entry_name
from .records import Estimation, Experiment

if TYPE_CHECKING:
    from ..flowsheet.process import Process

NOTABLE = 0.3  # of a direction's length: a number that belongs to it


class Fit(NamedTuple):
    """The fitted numbers, in the domain's units; P numbers, n measurements.

    - `values`, `low`, `high`: [P] with their confidence interval; NaN where not identified.
    - `covariance`, `correlation`: [P, P] of the fitted variables (a logarithm where so fitted).
    - `residuals`: [n], in standard deviations of the measurement; `chi2`: their sum of squares,
      of `freedom` = n - P degrees of freedom. `measured`, `fitted`: [n].
    - `condition`: largest over smallest singular value, variables scaled by their bounds.
    - `unidentified`: directions that the data do not narrow, in words; `converged` says why.
    """

    names: tuple[str, ...]
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    covariance: np.ndarray
    correlation: np.ndarray
    residuals: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    chi2: float
    freedom: int
    condition: float
    unidentified: tuple[str, ...]
    converged: bool
    message: str


def fit(process: "Process", estimation: Estimation) -> Fit:
    """Least squares from the case's own numbers, within the bounds."""
    model = model_of(process, estimation, estimation.experiments)
    log = np.array(estimation.logarithm)
    low, high = (variables_of(np.array(x), log) for x in (estimation.low, estimation.high))
    start = np.array([
        process.inputs[name][entry] for name, entry in zip(estimation.inputs, estimation.entries)
    ])  # fmt: skip
    error = np.concatenate([each.error for each in estimation.experiments])
    measured = np.concatenate([each.value for each in estimation.experiments])

    residual = jax.jit(lambda x: (model(numbers_of(x, log)) - measured) / error)
    slope = jax.jit(jax.jacfwd(residual))
    with jax.enable_x64(True):
        found = least_squares(
            lambda x: np.asarray(residual(x)),
            variables_of(start, log),
            jac=lambda x: np.asarray(slope(x)),  # pyright: ignore[reportArgumentType]
            bounds=(low, high),
            x_scale=high - low,
            xtol=1e-13,
            ftol=1e-13,
            gtol=1e-12,
            max_nfev=200,
        )
    names = tuple(
        entry_name(process.case, *each) for each in zip(estimation.inputs, estimation.entries)
    )
    values = np.where(log, np.exp(np.where(log, found.x, 0.0)), found.x)
    fitted = found.fun * error + measured
    return _with_intervals(found, values, measured, fitted, log, high - low, names, estimation)


def variables_of(values: np.ndarray, log: np.ndarray) -> np.ndarray:
    """[P] the fitted variables of numbers: their logarithm where `log`."""
    return np.where(log, np.log(np.where(log, values, 1.0)), values)


def numbers_of(variables, log: np.ndarray):
    """[P] the numbers of fitted variables; plain JAX."""
    return jnp.where(log, jnp.exp(jnp.where(log, variables, 0.0)), variables)


def model_of(process: "Process", estimation: Estimation, experiments: Sequence[Experiment]):
    """[P] fitted numbers -> [n] the model's values of the measurements, by experiment."""
    fitted = tuple(zip(estimation.inputs, estimation.entries))

    def run(numbers):
        found = []
        for experiment in experiments:
            changed = tuple((name, entry) for name, entry, _ in experiment.settings)
            given = jnp.array([value for *_, value in experiment.settings])
            inputs = {name: jnp.asarray(value) for name, value in process.inputs.items()}
            if changed:
                inputs = process.shifted(given, changed, inputs)
            inputs = process.shifted(numbers, fitted, inputs)
            found.append(_observed(process, inputs, experiment))
        return jnp.concatenate(found)

    return run


def _observed(process: "Process", inputs, experiment):
    """[n] states at their times, unit by unit, back in the order of the data."""
    units = [state.partition(".")[0] for state in experiment.state]
    found = jnp.zeros(len(units))
    for unit in dict.fromkeys(units):
        at = np.array([i for i, each in enumerate(units) if each == unit])
        states = tuple(experiment.state[i].partition(".")[2] for i in at)
        found = found.at[at].set(process.observe(inputs, unit, states, experiment.time[at]))
    return found


def _with_intervals(found, values, measured, fitted, log, width, names, estimation) -> Fit:
    """The covariance where the data identify all numbers, and words where they do not."""
    count, size = found.jac.shape
    _, singular, right = np.linalg.svd(found.jac * width, full_matrices=False)
    # One standard deviation along a direction as a share of the bounds: beyond 1 it says nothing.
    loose = singular < 1
    unidentified = tuple(_direction(right[i], names) for i in np.flatnonzero(loose))
    known = np.where(loose, 0.0, 1 / np.where(loose, 1.0, singular) ** 2)
    covariance = (right.T * known) @ right * np.outer(width, width)
    free = (np.abs(right[loose]) > NOTABLE).any(0) if loose.any() else np.zeros(size, bool)
    deviation = np.sqrt(np.diag(covariance))
    half = student.ppf((1 + estimation.level) / 2, max(count - size, 1)) * deviation
    ends = [found.x - half, found.x + half]
    low, high = (np.where(log, np.exp(np.where(log, x, 0.0)), x) for x in ends)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return Fit(
        names=names,
        values=values,
        low=np.where(free, np.nan, low),
        high=np.where(free, np.nan, high),
        covariance=covariance,
        correlation=correlation,
        residuals=found.fun,
        measured=measured,
        fitted=fitted,
        chi2=float(found.fun @ found.fun),
        freedom=count - size,
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf"),
        unidentified=unidentified,
        converged=found.status > 0,
        message=str(found.message),
    )


def _direction(row: np.ndarray, names: tuple[str, ...]) -> str:
    """The numbers that move together along a direction that the data leave free."""
    chosen = [names[i] for i in np.flatnonzero(np.abs(row) > NOTABLE)]
    if len(chosen) == 1:
        return f"{chosen[0]} is not identified by these data"
    return f"only a combination of {', '.join(chosen)} is identified by these data"
