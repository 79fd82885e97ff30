"""Maximum likelihood by Newton's method from several starts, and intervals from the curvature at
the maximum.

`maximise` searches from one start in plain JAX, so that many histories can be fitted together with
`jax.vmap`; `fit` takes the best result of several starts for one history. The Hessian is exact.
Away from the maximum the absolute values of its eigenvalues are used, so that each step increases
the likelihood (Nocedal and Wright (2006), "Numerical Optimization", section 3.4). A step that does
not increase it is halved.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.quickly import compiled_sooner
from snapo.solver.statistics import critical

from .kalman import Filtered, History, filtered, log_likelihood
from .model import CORRELATION, LEVEL, POSITIVE, RATE, HistoryModel
from .read import Calibration

MAX_STEPS = 150
CLOSE = 1e-9  # half of the squared distance to the maximum, in standard deviations
LONGEST = 1.0  # change of any variable in one step
SHORTEST, ROUNDING = 1e-12, 1e-13  # share of a step at which the search ends; of the value
DATES = 512  # histories are padded to multiples of it
FLAT = 1e-9  # of the largest eigenvalue: less is no curvature
SPEEDS = {1: (1.0, 8.0, 60.0), 2: (0.7, 3.0, 15.0)}  # per year, of the starts, by factors
ERROR = 0.3  # of a series' movement between two dates: its measurement error at the start
VANISHING = 1e-3  # of the same: a measurement error that runs to zero
SAME = 1e-3  # of the log-likelihood
# When an interval is too wide to be of use: see `unknown`.
DECADE, HALF_RANGE, SMALL_RATE, WIDE_LEVEL = 10.0, 1.0, 0.01, 0.5


class Maximum(NamedTuple):
    """A maximum: the `variables` [P], the `value` [] and the `hessian` [P, P] at it, and whether
    the search reached it."""

    variables: Float[Array, " P"]
    value: Float[Array, ""]
    hessian: Float[Array, "P P"]
    converged: Array


class _Search(NamedTuple):
    """The best point so far, the next point, and the share of a full step to it."""

    x: Array
    value: Array
    gradient: Array
    hessian: Array
    next: Array
    length: Array
    count: Array
    done: Array


def maximise(function: Callable[[Array], Array], start: Float[Array, " P"]) -> Maximum:
    """The maximum of a smooth function of P unbounded variables, searched from one start; plain
    JAX."""

    def slope(x):
        value, gradient = jax.value_and_grad(function)(x)
        return gradient, (value, gradient)

    def step(at: _Search) -> _Search:
        hessian, (value, gradient) = jax.jacfwd(slope, has_aux=True)(at.next)
        hessian = (hessian + hessian.T) / 2
        finite = jnp.isfinite(value) & jnp.isfinite(gradient).all() & jnp.isfinite(hessian).all()
        rises = finite & (value >= at.value - ROUNDING * jnp.abs(value))
        x, value, gradient, hessian = (
            jnp.where(rises, new, old)
            for new, old in zip((at.next, value, gradient, hessian), at[:4])
        )
        length = jnp.where(rises, jnp.minimum(2 * at.length, 1.0), at.length / 2)
        curvature, axes = jnp.linalg.eigh(hessian)
        curvature = jnp.maximum(jnp.abs(curvature), FLAT * jnp.max(jnp.abs(curvature)) + 1e-12)
        along = axes.T @ gradient
        direction = axes @ (along / curvature)
        capped = LONGEST / jnp.maximum(jnp.max(jnp.abs(direction)), LONGEST)
        close = jnp.sum(along**2 / curvature) / 2 < CLOSE
        done = (rises & close) | (length < SHORTEST)
        candidate = x + length * capped * direction
        return _Search(x, value, gradient, hessian, candidate, length, at.count + 1, done)

    size = len(start)
    none = -jnp.inf * jnp.ones(()), jnp.zeros(size), jnp.zeros((size, size))
    one = jnp.ones(()), jnp.zeros((), int), jnp.zeros((), bool)
    search = _Search(start, *none, start, *one)
    end = jax.lax.while_loop(lambda at: ~at.done & (at.count < MAX_STEPS), step, search)
    return Maximum(end.x, end.value, end.hessian, end.done & jnp.isfinite(end.value))


@dataclass(frozen=True, eq=False)
class HistoryEstimate:
    """The P parameters with the largest likelihood, in the order of the names of the model.

    - `numbers`, `errors` [P]: estimates and standard errors, in the units of the parameters.
    - `low`, `high` [P]: the 95 % interval, which is symmetric in the logarithm for positive
      parameters.
    - `covariance` [P, P]: the covariance of the estimates.
    - `unknown` [P]: whether the interval is so wide that the history does not determine the number.
    - `log_likelihood`, `converged`.
    """

    names: tuple[str, ...]
    numbers: np.ndarray
    errors: np.ndarray
    low: np.ndarray
    high: np.ndarray
    covariance: np.ndarray
    unknown: np.ndarray
    log_likelihood: float
    converged: bool


def estimate_of(model: HistoryModel, maximum: Maximum) -> HistoryEstimate:
    """Intervals from the observed information, the negative Hessian in unbounded variables.

    It must be called in the same precision as the search for the maximum.
    """
    x, hessian = np.asarray(maximum.variables), np.asarray(maximum.hessian)
    curvature, axes = np.linalg.eigh(-hessian)
    variance = 1 / np.maximum(curvature, FLAT * np.max(np.abs(curvature)))
    covariance = (axes * variance) @ axes.T
    half = critical() * np.sqrt(np.diag(covariance))
    slope = np.asarray(jax.jacfwd(model.numbers)(jnp.asarray(x)))
    endpoints = (x, x - half, x + half)
    numbers, low, high = (np.asarray(model.numbers(jnp.asarray(point))) for point in endpoints)
    natural = slope @ covariance @ slope.T
    return HistoryEstimate(
        model.names,
        numbers,
        np.sqrt(np.diag(natural)),
        low,
        high,
        natural,
        unknown(model, low, high),
        float(maximum.value),
        bool(maximum.converged),
    )


def unknown(model: HistoryModel, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """[P] whether an interval is too wide to be useful.

    This is so for a positive parameter if the upper end is more than ten times the lower end; for a
    correlation if the interval is longer than half of the range from -1 to 1; for a rate if not
    even its sign is certain and it may be above 1 % a year; and for a level if the interval extends
    more than half a unit of the logarithm in either direction.
    """
    width, unit = (high - low) / 2, model.units()
    table = {
        POSITIVE: high > DECADE * low,
        CORRELATION: 2 * width > HALF_RANGE,
        RATE: (low < 0) & (high > 0) & (width > SMALL_RATE * unit),
        LEVEL: width > WIDE_LEVEL * unit,
    }
    never = np.zeros(len(low), bool)
    roles = [parameter.role for parameter in model.parameters]
    return np.array([table.get(role, never)[i] for i, role in enumerate(roles)])


@dataclass(frozen=True, eq=False)
class HistoryFit:
    """The estimates of a calibration.

    - `model`: the model; its `exact` also has the series whose measurement error is estimated as
      zero.
    - `estimate`: the estimates; `states`: the filtered factors of each date at the estimates, as
      NumPy arrays.
    - `vanished`: the series whose measurement error vanished at the maximum.
    """

    model: HistoryModel
    estimate: HistoryEstimate
    states: Filtered
    vanished: tuple[str, ...]


def fit(calibration: Calibration) -> HistoryFit:
    """Maximises the likelihood in float64."""
    model, vanished = calibration.model, []
    with jax.enable_x64(True):
        maximum = _best(model, calibration, _starts(model, calibration))
        while (series := _vanishing(model, maximum, calibration)) is not None:
            smaller = replace(model, exact=(*model.exact, series))
            position = model.names.index(f"deviation_{series}")
            start = np.delete(np.asarray(maximum.variables), position)
            without = _best(smaller, calibration, start[None])
            if not without.value >= maximum.value - SAME:
                break
            model, maximum = smaller, without
            vanished.append(series)
        estimate = estimate_of(model, maximum)
        states = _states(model, jnp.asarray(estimate.numbers), padded(calibration.history))
        states = jax.tree.map(np.asarray, states)
    days = len(calibration.days)
    states = states._replace(mean=states.mean[:days], covariance=states.covariance[:days])
    return HistoryFit(model, estimate, states, tuple(vanished))


def _best(model: HistoryModel, calibration: Calibration, starts: np.ndarray) -> Maximum:
    """The highest of the maxima that the searches from the starts [n, P] reach."""
    history = jax.tree.map(jnp.asarray, padded(calibration.history))
    maxima = _maxima(model, history, jnp.asarray(starts))
    value = np.where(np.isfinite(maxima.value), maxima.value, -np.inf)
    best = int(np.argmax(value))
    return jax.tree.map(lambda x: x[best], maxima)


@compiled_sooner
def _maxima(model: HistoryModel, history: History, starts: Array) -> Maximum:
    """The maxima that the searches from the starts [n, P] reach."""

    def search(start):
        return maximise(lambda x: log_likelihood(model, model.numbers(x), history), start)

    return jax.vmap(search)(starts)


@compiled_sooner
def _states(model: HistoryModel, numbers: Array, history: History) -> Filtered:
    return filtered(model, numbers, history)


def padded(history: History) -> History:
    """The history, extended by dates without prices at the time of the last date, so that histories
    of almost the same length need only one compilation."""
    more = -len(history.gap) % DATES
    rows: Any = (np.pad(x, [(0, more)] + [(0, 0)] * (x.ndim - 1)) for x in history[:-1])
    return History(*rows, first=history.first)


def _starts(model: HistoryModel, calibration: Calibration) -> np.ndarray:
    """[n, P] the variables of the starts: volatilities that match the moves of the series, with
    several mean reversions."""
    history = calibration.history
    movements = [_movement(calibration, i) for i in range(len(model.columns))]
    yearly = np.array([size / np.sqrt(time) for size, time in movements])
    numbers = dict.fromkeys(model.names, 0.0)
    numbers["volatility"] = float(np.max(yearly))
    if model.factors == 2:
        numbers["long_volatility"], numbers["correlation"] = 0.7 * float(np.min(yearly)), 0.1
    else:
        numbers["level"] = float(np.mean(np.asarray(history.value)[np.asarray(history.present)]))
    for name, (size, _) in zip(model.columns, movements):
        if name not in model.exact:
            numbers[f"deviation_{name}"] = ERROR * size
    rows = [
        model.variables(np.array(list((numbers | {"mean_reversion": speed}).values())))
        for speed in SPEEDS[model.factors]
    ]
    return np.stack(rows)


def _movement(calibration: Calibration, column: int) -> tuple[float, float]:
    """The standard deviation of the change of a series between two dates, which is not zero, and
    the time between them.

    If a date has several prices, the first one is used.
    """
    history = calibration.history
    mask = np.asarray(history.present) & (np.asarray(history.column) == column)
    dates = np.flatnonzero(mask.any(axis=1))
    value = np.asarray(history.value)[dates, mask[dates].argmax(axis=1)]
    time = np.cumsum(np.asarray(history.gap))[dates]
    smallest = 1e-4 * calibration.model.unit
    if len(dates) < 3:
        return max(smallest, 0.02 * calibration.model.unit), 1 / 365
    size = float(np.sqrt(np.mean(np.diff(value) ** 2)))
    return max(size, smallest), float(np.mean(np.diff(time)))


def _vanishing(model: HistoryModel, maximum: Maximum, calibration: Calibration) -> str | None:
    """The series whose measurement error tends to zero; None if no more series may be exact."""
    numbers = dict(zip(model.names, np.asarray(model.numbers(maximum.variables))))
    for i, name in enumerate(model.columns):
        deviation = numbers.get(f"deviation_{name}")
        if deviation is None or len(model.exact) >= model.factors or name == "quotes":
            continue
        if deviation < VANISHING * _movement(calibration, i)[0]:
            return name
    return None
