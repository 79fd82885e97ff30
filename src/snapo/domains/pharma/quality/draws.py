"""Batches that differ: values of all uncertain numbers, and of parameters that vary.

Every draw is made from standard normals that do not depend on the set point, so two set points have
the same batches. Draw i does not depend on the number of draws.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from snapo.case.quantity import numbers_in

from ..flowsheet.case import PharmaCase, process_entries
from ..given import Entry
from .records import Distribution


def entries(case: PharmaCase) -> tuple[Entry, ...]:
    """[U] (input, entry) of the uncertain model parameters."""
    return tuple(zip(case.uncertainty.inputs, case.uncertainty.entries))


def all_entries(case: PharmaCase) -> tuple[Entry, ...]:
    """[V] the uncertain model parameters, and after them the process parameters that vary."""
    return entries(case) + process_entries(case)


def unknown(case: PharmaCase) -> np.ndarray:
    """[E] for the entries of `batches.varied`: whether an entry is an unknown number that is the
    same in every batch."""
    between = case.uncertainty.between or tuple(w == "step" for w in case.uncertainty.when)
    rest = {(parameter.input, parameter.entry) for parameter in case.parameters} - set(
        entries(case)
    )
    return np.array([not item for item in between] + [False] * len(rest), bool)


def draw(
    case: PharmaCase, n: int, seed: int, about: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """[n, U] values of `entries(case)` in the domain's units, about the inputs `about`."""
    result = entries(case)
    return values(case.uncertainty.distributions, normals(case, n, seed)[:, : len(result)],
                  nominal(case, result, about))  # fmt: skip


def process_draws(
    case: PharmaCase, n: int, seed: int, about: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """[n, P] values of `process_entries(case)`, around the inputs `about`."""
    result = process_entries(case)
    kinds = [parameter.distribution for parameter in case.parameters if parameter.distribution]
    inputs = normals(case, n, seed)[:, len(entries(case)) :]
    return values(kinds, inputs, nominal(case, result, about))


def all_draws(
    case: PharmaCase, n: int, seed: int, about: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """[n, V] values of `all_entries(case)`: `draw` and `process_draws` side by side."""
    return np.hstack([draw(case, n, seed, about), process_draws(case, n, seed, about)])


def nominal(
    case: PharmaCase, which: Iterable[Entry], about: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """Values of some entries, from `about` if it has them, otherwise from the case."""
    inputs = {item.name: item.values for item in _givens(case)} | dict(about or {})
    return np.array([inputs[name][entry] for name, entry in which], np.float64)


def _givens(case: PharmaCase):
    return numbers_in((case.network, case.feeds, case.units))


def normals(case: PharmaCase, n: int, seed: int) -> np.ndarray:
    """[n, V] standard normals behind `all_draws`, with the correlation of the uncertainty."""
    size = len(all_entries(case))
    uniform = np.random.Generator(np.random.Philox(key=seed)).random((n, size))
    # Half of the generator's last digit keeps the inverse normal away from minus infinity.
    free = ndtri(uniform + 2.0**-54)
    available = len(entries(case))
    if available:
        free[:, :available] = (
            free[:, :available] @ np.linalg.cholesky(case.uncertainty.correlation).T
        )
    return free


def values(
    distributions: Sequence[Distribution], normal: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """[n, V] values from standard normals [n, V] and nominal values [V]."""
    result = np.empty(normal.shape)
    for i, distribution in enumerate(distributions):
        result[:, i] = value(distribution, normal[:, i], centre[i])
    return result


def value(distribution: Distribution, z: np.ndarray, centre) -> np.ndarray:
    """The values for standard normals; the exact formulas are those of `Distribution`."""
    spread = distribution.spread
    match distribution.kind:
        case "normal":
            return centre + spread * z
        case "lognormal":
            return centre * np.exp(spread * z - spread**2 / 2)
        case "logarithm":
            return centre * np.exp(spread * z)
        case "uniform":
            return centre + spread * (2 * ndtr(z) - 1)


def deviation(distribution: Distribution, centre: float) -> float:
    """Standard deviation of a distribution about `centre`, in the domain's unit; of a number fitted
    as its logarithm to first order, so that correlated numbers compensate each other."""
    match distribution.kind:
        case "normal":
            return distribution.spread
        case "lognormal":
            return abs(centre) * math.sqrt(math.expm1(distribution.spread**2))
        case "logarithm":
            return abs(centre) * distribution.spread
        case "uniform":
            return distribution.spread / math.sqrt(3)
