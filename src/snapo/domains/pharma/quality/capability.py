"""Process capability at the set point: spread, Cpk and out-of-specification rates from draws."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from snapo.solver.statistics import proportion
from snapo.study.chapter import Floats, Number

from ..flowsheet.case import PharmaCase
from . import batches, draws
from .batches import AttributeLimits

if TYPE_CHECKING:
    from ..flowsheet.process import PharmaProcess


WORLDS, INNER = 64, 32  # draws of the uncertain numbers, and batches for each
NOMINAL = 512  # batches with the nominal numbers
ROUND_OFF = 1e-12  # of the mean: a smaller deviation counts as zero


@dataclass(frozen=True, eq=False)
class Capability:
    """Statistics of n fresh batches at the set point; every array is [Q].

    - `cpk`: min(high - mean, mean - low) / (3 deviation), which assumes a normal attribute; NaN
      without a limit. `sigmas`: the distance to the nearest limit in standard deviations, which is
      3 Cpk.
    - `outside`: share of batches beyond the limits, with its standard error `error`.
    - `quantiles`: [Q, 3] 1 %, 50 %, 99 %.
    - `joint`: share of batches beyond any limit, and `joint_error`.

    All of these include the uncertain numbers and the differences between batches. Separately:

    - `cpk_batches`: Cpk of differences between batches only, with the model's numbers at their
      nominal values; NaN if nothing differs. `cpk_low`, `cpk_high`: 5 % and 95 % of it over the
      model's uncertain numbers; NaN if all are known.
    """

    mean: Floats
    deviation: Floats
    cpk: Floats
    sigmas: Floats
    outside: Floats
    error: Floats
    quantiles: Floats
    joint: Number
    joint_error: Number
    batches: int
    failed: int
    cpk_batches: Floats
    cpk_low: Floats
    cpk_high: Floats


def capability(process: "PharmaProcess", count: int, seed: int) -> Capability:
    """The capability from draws of all uncertain numbers and of the parameters that vary, at the
    set point."""
    rows = batches.drawn(process, {}, count, seed)
    values = from_values(process.case, batches.attributes(process, rows))
    return replace(values, **_apart(process, seed))


def from_values(case: PharmaCase, values: np.ndarray) -> Capability:
    """The capability from attributes [n, Q]; non-finite rows are failures that violate all
    limits."""
    limits, count = AttributeLimits.of(case), len(values)
    selected = limits.hold(values)
    valid = np.isfinite(values).all(-1)
    finite = values[valid]
    mean, deviation = finite.mean(0), finite.std(0, ddof=1)
    sigmas, unknown = 3 * _cpk(limits, finite), np.full(len(mean), np.nan)
    outside, joint = 1 - selected.mean(0), float(1 - selected.all(-1).mean())
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
        failed=int(count - valid.sum()),
        cpk_batches=unknown,
        cpk_low=unknown,
        cpk_high=unknown,
    )


def _cpk(limits: AttributeLimits, values: np.ndarray) -> np.ndarray:
    """[..., Q] Cpk of attributes [..., n, Q]; NaN without a limit and without spread."""
    mean, deviation = values.mean(-2), values.std(-2, ddof=1)
    varies = limits.any() & (deviation > ROUND_OFF * np.abs(mean))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(varies, limits.distance(mean) / (3 * deviation), np.nan)


def _apart(process: "PharmaProcess", seed: int) -> dict[str, np.ndarray]:
    """Cpk between batches, and its interval over `WORLDS` draws of the uncertain numbers, with the
    same `INNER` batches for every draw."""
    limits, uncertain = AttributeLimits.of(process.case), draws.unknown(process.case)

    def in_worlds(worlds: np.ndarray, inner: np.ndarray) -> np.ndarray:
        rows = np.tile(inner, (len(worlds), 1, 1))
        rows[..., uncertain] = worlds[:, None, uncertain]
        values = batches.attributes(process, rows.reshape(-1, rows.shape[-1]))
        return _cpk(limits, values.reshape(*rows.shape[:2], -1))

    inner = batches.drawn(process, {}, NOMINAL, seed + 1)
    nominal = in_worlds(batches.nominally(process, {}), inner)[0]
    endpoints = np.full((2, len(nominal)), np.nan)
    if uncertain.any():
        worlds = batches.drawn(process, {}, WORLDS, seed + 2)
        endpoints = np.quantile(in_worlds(worlds, inner[:INNER]), [0.05, 0.95], axis=0)
    return {"cpk_batches": nominal, "cpk_low": endpoints[0], "cpk_high": endpoints[1]}
