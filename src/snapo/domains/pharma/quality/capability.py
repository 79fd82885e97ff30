"""Process capability at the set point: spread, Cpk and out-of-specification rates from draws."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from snapo.solver.statistics import proportion

from ..flowsheet.case import PharmaCase
from . import batches
from .limits import Limits

if TYPE_CHECKING:
    from ..flowsheet.process import Process


class Capability(NamedTuple):
    """[Q] each, over n fresh batches at the set point.

    - `cpk`: min(high - mean, mean - low) / (3 deviation), which takes the attribute for normal;
      NaN without a limit. `sigmas`: the distance to the edge of failure in deviations, 3 Cpk.
    - `outside`: share of batches beyond the limits, with its standard error `error`.
    - `quantiles`: [Q, 3] 1 %, 50 %, 99 %.
    - `joint`: share of batches beyond any limit, and `joint_error`.
    """

    mean: np.ndarray
    deviation: np.ndarray
    cpk: np.ndarray
    sigmas: np.ndarray
    outside: np.ndarray
    error: np.ndarray
    quantiles: np.ndarray
    joint: float
    joint_error: float
    batches: int
    failed: int


def capability(process: "Process", count: int, seed: int) -> Capability:
    """Draws of everything uncertain and of parameters that vary, at the set point."""
    rows = batches.drawn(process, {}, count, seed)
    return from_values(process.case, batches.attributes(process, rows))


def from_values(case: PharmaCase, values: np.ndarray) -> Capability:
    """The same from attributes [n, Q]; rows that are not finite broke down and break all limits."""
    limits, count = Limits.of(case), len(values)
    kept = limits.hold(values)
    good = np.isfinite(values).all(-1)
    finite = values[good]
    mean, deviation = finite.mean(0), finite.std(0, ddof=1)
    room = limits.distance(mean)
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = np.where(limits.any(), room / deviation, np.nan)
    outside, joint = 1 - kept.mean(0), float(1 - kept.all(-1).mean())
    return Capability(
        mean=mean,
        deviation=deviation,
        cpk=sigmas / 3,
        sigmas=sigmas,
        outside=outside,
        error=proportion(count * outside, count)[1],
        quantiles=np.quantile(finite, [0.01, 0.5, 0.99], axis=0).T,
        joint=joint,
        joint_error=float(proportion(count * joint, count)[1]),
        batches=count,
        failed=int(count - good.sum()),
    )
