"""Measured batches that no number was fitted to: predicted with intervals, which are counted.

To first order a prediction has the covariance V = G C G^T, C that of the fitted variables and G the
model's derivatives by them; a measurement has its own error beside it. An interval holds the
measurement with the given chance if both are right (Seber and Wild, Nonlinear Regression, 1989,
section 5.1). Points of one batch err together, by V: r^T (V + E)^-1 r of a batch, E the squared
errors, is chi-squared, and its tail says whether the batch as a whole is as the model expects.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from .estimation import Fit, model_of, numbers_of, variables_of
from .interval import interval
from .records import Estimation

if TYPE_CHECKING:
    from ..flowsheet.process import Process


class Agreement(NamedTuple):
    """One batch: `points` measured, of which `inside` lie in their intervals; `chi2` of all of them
    together, and `tail`, the chance of more than that."""

    experiment: str
    points: int
    inside: int
    chi2: float
    tail: float


class Validation(NamedTuple):
    """[n] measurements held out, in the domain's units.

    - `measured`, `predicted`; `deviation` of the prediction by what the fit does not know; `half`:
      of the interval about the prediction that holds a measurement.
    - `coverage`: share inside, with its 95 % interval `low` to `high` as of independent points.
    """

    measured: np.ndarray
    predicted: np.ndarray
    deviation: np.ndarray
    half: np.ndarray
    coverage: float
    low: float
    high: float
    batches: tuple[Agreement, ...]


def validate(process: "Process", estimation: Estimation, fit: Fit) -> Validation | None:
    """The batches that were held out; None where there are none."""
    if not estimation.held_out:
        return None
    model = model_of(process, estimation, estimation.held_out)
    log = np.array(estimation.logarithm)

    def both(x):
        found = model(numbers_of(x, log))
        return found, found

    with jax.enable_x64(True):
        slope, found = jax.jit(jax.jacfwd(both, has_aux=True))(variables_of(fit.values, log))
    slope, predicted = np.asarray(slope), np.asarray(found)
    measured = np.concatenate([each.value for each in estimation.held_out])
    error = np.concatenate([each.error for each in estimation.held_out])
    if estimation.errors == "relative":
        error = error * np.sqrt(fit.scale)
    spread = slope @ fit.covariance @ slope.T
    deviation = np.sqrt(np.diag(spread))
    factor = student.ppf((1 + estimation.level) / 2, max(fit.freedom, 1))
    half = factor * np.sqrt(deviation**2 + error**2)
    inside = np.abs(measured - predicted) <= half
    low, high = interval(inside.mean(), inside.size)
    batches, start = [], 0
    for each in estimation.held_out:
        at = slice(start, start + len(each.time))
        off, whole = (measured - predicted)[at], spread[at, at] + np.diag(error[at] ** 2)
        size = float(off @ np.linalg.solve(whole, off))
        tail = float(chi2.sf(size, len(off)))
        batches.append(Agreement(each.name, len(off), int(inside[at].sum()), size, tail))
        start += len(each.time)
    share = float(inside.mean())
    return Validation(
        measured, predicted, deviation, half, share, float(low), float(high), tuple(batches)
    )
