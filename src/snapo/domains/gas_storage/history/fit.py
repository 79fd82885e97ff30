"""The largest likelihood of a calibration, from several starts."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .kalman import Filtered, filtered, log_likelihood
from .maximum import HistoryEstimate, Maximum, estimate_of, maximise
from .model import HistoryModel
from .read import Calibration

SPEEDS = {1: (1.0, 8.0, 60.0), 2: (0.7, 3.0, 15.0)}  # per year, of the starts, by factors
ERROR = 0.3  # of a series' movement between two dates: its measurement error at the start
VANISHING = 1e-3  # of the same: a measurement error that runs to zero
SAME = 1e-3  # of the log-likelihood


@dataclass(frozen=True, eq=False)
class HistoryFit:
    """The estimates of a calibration.

    - `model`: `exact` also has the series without a measurement error at the maximum.
    - `estimate`; `states`: the filtered factors of each date at the estimates, as NumPy arrays.
    - `vanished`: those series.
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
        states = jax.jit(partial(filtered, model))(estimate.numbers, calibration.history)
        states = jax.tree.map(np.asarray, states)
    return HistoryFit(model, estimate, states, tuple(vanished))


def _best(model: HistoryModel, calibration: Calibration, starts: np.ndarray) -> Maximum:
    """The highest of the maxima that are reached from the starts [n, P]."""
    history = jax.tree.map(jnp.asarray, calibration.history)

    def search(start):
        return maximise(lambda x: log_likelihood(model, model.numbers(x), history), start)

    maxima = jax.jit(jax.vmap(search))(jnp.asarray(starts))
    value = np.where(np.isfinite(maxima.value), maxima.value, -np.inf)
    best = int(np.argmax(value))
    return jax.tree.map(lambda x: x[best], maxima)


def _starts(model: HistoryModel, calibration: Calibration) -> np.ndarray:
    """[n, P] variables: volatilities as the series move, at several mean reversions."""
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
    """Standard deviation of a series between two dates, not zero, and the time between them.

    Of several prices of a date the first counts.
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
    """The series whose measurement error runs to zero, if one more may be exact."""
    numbers = dict(zip(model.names, np.asarray(model.numbers(maximum.variables))))
    for i, name in enumerate(model.columns):
        deviation = numbers.get(f"deviation_{name}")
        if deviation is None or len(model.exact) >= model.factors or name == "quotes":
            continue
        if deviation < VANISHING * _movement(calibration, i)[0]:
            return name
    return None
