"""Smooth daily prices with prescribed means over some periods; the prices are linear in these
means.

The price of day d is s[d] g[d], with the factor s of the day (weekends are cheaper) and a smooth g:

- "daily": the numbers g with the smallest sum of squared second differences;
- "spline": g[d] is the mean over day d of a function f, a polynomial of fourth degree between the
  limits of periods, twice continuously differentiable, with the smallest integral of f''^2; its
  slope at the end is zero if the end is flat (Benth, Koekebakker, Ollmar 2007, "Extracting and
  applying smooth forward curves from average-based commodity contracts with seasonal variation",
  Journal of Derivatives 15).

In both cases the prices solve a linear system with the means on its right-hand side.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu

Smoother = Literal["daily", "spline"]
MeanPeriod = tuple[int, int]  # the first day and the day after the last one, counted from the first
DEGREE = 4
POWERS = np.arange(DEGREE + 1)


class Undetermined(ValueError):
    """The periods do not determine the curve."""


def prices_of_means(
    periods: Sequence[MeanPeriod],
    factors: Float[np.ndarray, " D"],
    smoother: Smoother = "daily",
    flat_end: bool = True,
) -> Float[np.ndarray, "D n"]:
    """[D, n] the derivative of the price of each day with respect to the mean over each period.

    `factors`: the factors of the days of the week. `flat_end`: whether the slope of a spline at its
    end is zero. The means are independent of one another.

    **Raises:** `Undetermined` if several curves are equally smooth.
    """
    count = len(factors)
    means: Any = sparse.lil_array((len(periods), count))
    for row, (first, after) in enumerate(periods):
        means[row, first:after] = factors[first:after] / (after - first)
    if len(periods) == 1:
        return (factors / (means @ np.ones(count)))[:, None]
    if smoother == "daily" or not flat_end:  # a straight line is smooth
        straight = np.stack([np.ones(count), np.linspace(-1, 1, count)], axis=1)
        if np.linalg.matrix_rank(means @ straight, tol=1e-9) < 2:
            raise Undetermined
    if smoother == "daily":
        one: Any = sparse.eye_array(count, format="csr")
        second = one[2:] - 2 * one[1:-1] + one[:-2]
        basis, rough, joined = one, second.T @ second, None
    else:
        basis, rough, joined = _spline(sorted({x for p in periods for x in p}), count, flat_end)
    given = means.tocsr() @ basis
    fixed: Any = given if joined is None else sparse.vstack([joined, given])
    system: Any = sparse.block_array([[rough, fixed.T], [fixed, None]], format="csc")
    right = np.zeros((basis.shape[1] + fixed.shape[0], len(periods)))
    right[-len(periods) :] = np.eye(len(periods))
    solved = splu(system).solve(right)[: basis.shape[1]]
    return factors[:, None] * (basis @ solved)


def _spline(knots: Sequence[int], count: int, flat_end: bool) -> tuple[Any, Any, Any]:
    """Three matrices for the K coefficients of all pieces: [D, K] the means over each day; the
    integral of the squared second derivative; and the differences at the joins of pieces, which are
    zero."""
    pieces, widths = len(knots) - 1, np.diff(knots).astype(float)
    days: Any = sparse.lil_array((count, pieces * (DEGREE + 1)))
    for j, (start, after) in enumerate(pairwise(knots)):
        edges = np.arange(after - start + 1)[:, None] / widths[j]
        integral = edges ** (POWERS + 1) / (POWERS + 1)
        days[start:after, _columns(j)] = np.diff(integral, axis=0) * widths[j]
    joins: Any = sparse.lil_array((3 * (pieces - 1) + flat_end, days.shape[1]))
    for j in range(pieces - 1):
        for order in range(3):
            joins[3 * j + order, _columns(j)] = _derivative(1.0, order) / widths[j] ** order
            joins[3 * j + order, _columns(j + 1)] = (
                -_derivative(0.0, order) / widths[j + 1] ** order
            )
    if flat_end:
        joins[-1, _columns(pieces - 1)] = _derivative(1.0, 1)
    rough = sparse.block_diag([_roughness() / width**3 for width in widths])
    return days.tocsr(), rough, joins.tocsr()


def _columns(piece: int) -> slice:
    return slice(piece * (DEGREE + 1), (piece + 1) * (DEGREE + 1))


def _derivative(u: float, order: int) -> np.ndarray:
    """The derivative of each power at u, on one piece."""
    factors = np.prod([POWERS - k for k in range(order)], axis=0, initial=1)
    return factors * u ** np.maximum(POWERS - order, 0)


def _roughness() -> np.ndarray:
    """The integral over [0, 1] of products of second derivatives of the powers."""
    a, b = POWERS[:, None], POWERS[None, :]
    power = np.maximum(a + b - 3, 1)
    return a * (a - 1) * b * (b - 1) / power * ((a > 1) & (b > 1))
