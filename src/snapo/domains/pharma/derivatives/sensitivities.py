"""The sensitivity matrix in its reported forms: raw, over the normal range, as a share of the
margin.

Also the criticality of parameters, and the shares of sources in the variance, to first order.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from snapo.case.quantity import numbers_in
from snapo.study.chapter import Floats, Number

from ..flowsheet.case import PharmaCase
from ..quality.batches import AttributeLimits
from ..quality.draws import all_entries, deviation, nominal
from .jacobian import Jacobian

VARIATION = 2.0  # standard deviations of the batches that are not there to be used
BEYOND = 1e6  # above any share of a room


class MatrixForms(NamedTuple):
    """Q attributes by P parameters.

    - `raw`: in the attribute's unit per case's unit of the parameter.
    - `scaled`: change of the attribute over half the normal operating range.
    - `share`: `scaled` divided by the distance to the nearest limit. NaN if the attribute has no
      limit, 0 if the derivative is 0, infinite if the attribute is on or beyond its limit.
    - `zero`: whether the derivative is exactly 0.0: the parameter has no effect on the attribute.
    """

    raw: np.ndarray
    scaled: np.ndarray
    share: np.ndarray
    zero: np.ndarray


def table(case: PharmaCase, matrix: Jacobian) -> MatrixForms:
    """The three forms of a `matrix` whose columns are the case's parameters in order."""
    scale = np.array([parameter.scale for parameter in case.parameters])
    half = np.array([(item.normal_high - item.normal_low) / 2 for item in case.parameters])
    scaled = matrix.jacobian * half
    room = AttributeLimits.of(case).distance(matrix.values)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(room > 0, scaled / room, np.sign(scaled) * np.inf)
    share = np.where(matrix.jacobian == 0, 0.0, share)
    share = np.where(AttributeLimits.of(case).any()[:, None], share, np.nan)
    return MatrixForms(matrix.jacobian * scale, scaled, share, matrix.jacobian == 0)


@dataclass(frozen=True)
class Rank:
    """The criticality of a parameter. Here the margin is the distance to a limit that the variation
    of batches leaves; `share` is the largest share of it that the parameter uses. `variance`: its
    share of that attribute's variance."""

    parameter: str
    share: Number
    attribute: str
    outside: bool
    spent: bool
    variance: Number


def ranking(case: PharmaCase, forms: MatrixForms, matrix: Jacobian, varied: "Spread") -> list[Rank]:
    """Parameters by criticality, the most critical first.

    Here the margin is the distance to the nearest limit minus `VARIATION` standard deviations of
    the batches around the set point. `outside`: the attribute is already beyond its limit; `spent`:
    the variation of the batches takes all of the margin. In both cases a share has no meaning.
    """
    room = AttributeLimits.of(case).distance(matrix.values)
    left = (room - VARIATION * varied.total)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(left > 0, np.abs(forms.scaled) / left, np.inf)
        variances = np.nan_to_num(varied.part**2 / (varied.part**2).sum(1, keepdims=True))
    shares = np.where(forms.zero, 0.0, shares)
    shares = np.where(AttributeLimits.of(case).any()[:, None], shares, np.nan)
    # Where no room is left, the room without variation decides which parameter comes first.
    plain = np.minimum(np.nan_to_num(np.abs(forms.share), posinf=BEYOND), BEYOND)
    ranks: list[Rank] = []
    order: list[float] = []
    for p, parameter in enumerate(case.parameters):
        size = shares[:, p]
        size = np.where(np.isnan(size), -1.0, size)
        size = np.where(np.isinf(size), BEYOND * (1 + plain[:, p]), size)
        worst = int(np.argmax(size))
        available = size[worst] >= 0
        ranks.append(
            Rank(
                parameter.name,
                float(shares[worst, p]) if available else float("nan"),
                case.attributes[worst].name if available and size[worst] > 0 else "",
                bool(np.isinf(shares[worst, p]) and room[worst] <= 0),
                bool(np.isinf(shares[worst, p]) and room[worst] > 0),
                _of_variance(varied, variances[worst], parameter.name),
            )
        )
        order.append(-float(size[worst]))
    return [ranks[i] for i in np.argsort(order, kind="stable")]


def _of_variance(varied: "Spread", shares: np.ndarray, name: str) -> float:
    """The share of an attribute's variance that one source causes, 0 if it does not vary."""
    return float(shares[varied.sources.index(name)]) if name in varied.sources else 0.0


@dataclass(frozen=True, eq=False)
class Spread:
    """The sources of the batch-to-batch spread of each attribute, to first order.

    - `sources`: [V] names; `part`: [Q, V] standard deviation that each source causes.
    - `total`: [Q] standard deviation due to all sources, in quadrature (a correlation adds its
      terms).
    """

    sources: tuple[str, ...]
    part: Floats
    total: Floats


def spread(case: PharmaCase, jacobian: np.ndarray) -> Spread:
    """The spread from the `jacobian` [Q, V] with respect to `all_entries(case)`, per domain
    unit."""
    which = all_entries(case)
    centre = nominal(case, which)
    kinds = list(case.uncertainty.distributions)
    kinds += [parameter.distribution for parameter in case.parameters if parameter.distribution]
    sigma = np.array([deviation(kind, x) for kind, x in zip(kinds, centre)])
    correlation = np.eye(len(which))
    available = len(case.uncertainty.inputs)
    correlation[:available, :available] = case.uncertainty.correlation
    signed = jacobian * sigma
    variance = np.einsum("qi,ij,qj->q", signed, correlation, signed)
    return Spread(source_names(case), np.abs(signed), np.sqrt(variance))


def source_names(case: PharmaCase) -> tuple[str, ...]:
    """[V] The names of `all_entries(case)`: the name of a parameter, or of a number with its
    label."""
    names = {(parameter.input, parameter.entry): parameter.name for parameter in case.parameters}
    return tuple(names.get(entry) or entry_name(case, *entry) for entry in all_entries(case))


def entry_name(case: PharmaCase, name: str, entry: int) -> str:
    """ "kinetics.prefactor[product]"; a single number has no brackets."""
    for values in numbers_in((case.network, case.feeds, case.units)):
        if values.name == name and len(values.labels) > 1:
            return f"{name}[{values.labels[entry]}]"
    return name
