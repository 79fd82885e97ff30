"""The correlation matrix of all Brownian motions of a case, and the repair of an invalid one.

Brownian motions in order: factors of the short rate, expected inflation, price index, wage,
mortality, ratings, currencies, asset classes with a separate shock.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import updated, xp

from ..records.assets import Assets
from ..records.case import PensionModel
from ..records.inputs import use

SMALLEST = 1e-6  # eigenvalue of a repaired matrix
ROUNDS = 500


MORTALITY = ""  # the name of a motion that no case can correlate


def brownians(case: PensionModel) -> tuple[str, ...]:
    """The names of all Brownian motions, in order."""
    return all_names(case.rates.factors, case.credit.names, case.currencies.names, case.assets)


def all_names(
    factors: Sequence[str], ratings: Sequence[str], currencies: Sequence[str], assets: Assets
) -> tuple[str, ...]:
    """The names of all Brownian motions, from the parts of a case."""
    local = tuple(assets.classes[i].name for i in assets.shocks)
    market = ("inflation", "price index", "wage", MORTALITY)
    return (*factors, *market, *ratings, *currencies, *local)


def matrix(case: PensionModel, inputs: dict[str, Any]) -> Float[Array, "B B"]:
    """Instantaneous correlations; motions that the case does not name are independent."""
    names = brownians(case)
    position = [names.index(name) for name in case.correlation.names]
    below = np.tril_indices(len(position), -1)
    rows, columns = np.array(position, int)[below[0]], np.array(position, int)[below[1]]
    values = use(inputs, case.correlation.lower)
    lower = updated(xp.zeros((len(names), len(names))), (rows, columns), values)
    return xp.eye(len(names)) + lower + lower.T


def check_correlation(correlations: np.ndarray) -> float:
    """The smallest eigenvalue; that of a positive definite matrix is above zero."""
    return float(np.linalg.eigvalsh(correlations)[0])


def nearest(correlations: np.ndarray) -> tuple[np.ndarray, float]:
    """The nearest positive definite correlation matrix and the largest change of an entry.

    Alternating projections with Dykstra's correction (N. Higham, IMA J. Numer. Anal. 22, 2002),
    onto eigenvalues of at least `SMALLEST` and onto a diagonal of ones.
    """
    current, correction = correlations.copy(), np.zeros_like(correlations)
    for _ in range(ROUNDS):
        shifted = current - correction
        values, vectors = np.linalg.eigh(shifted)
        raised = (vectors * np.maximum(values, SMALLEST)) @ vectors.T
        correction = raised - shifted
        before, current = current, raised.copy()
        np.fill_diagonal(current, 1.0)
        if np.max(np.abs(current - before)) < 1e-12:
            break
    # The last projection may leave an eigenvalue a hair below; scaling keeps the diagonal.
    values, vectors = np.linalg.eigh(current)
    current = (vectors * np.maximum(values, SMALLEST)) @ vectors.T
    scale = 1 / np.sqrt(np.diag(current))
    current = current * np.outer(scale, scale)
    return current, float(np.max(np.abs(current - correlations)))
