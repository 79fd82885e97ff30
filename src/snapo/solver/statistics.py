"""Standard errors of the package, from independent groups of paths.

Paths are independent in groups only: an antithetic pair is one draw, and so is a Sobol scramble
(`Scenarios.groups`). Values [N] of paths become `shares`, one for each group, whose mean is the
estimate and whose spread is its error: sums and ratios by the linearised ratio (Cochran, Sampling
Techniques, 1977, section 6.3), other statistics by their influence function. Results computed block
by block become an `Estimate`, by a jackknife over the blocks (`by_block`). Intervals are Student's.

In all output, ± is followed by half of a 95 % interval, from simulation
error only; files and attributes contain the `standard_error`.
"""

from decimal import Decimal
from itertools import islice
from typing import NamedTuple

import numpy as np

SHOWN = 3  # numbers of an array that are printed
LEVEL = 0.95  # of an interval, by default


def half_width(error: float, degrees: float = np.inf) -> float:
    """Half of the 95 % interval of an estimate with this standard error."""
    return critical(degrees) * error


def plus_minus(error: float, digits: int = 2, degrees: float = np.inf) -> str:
    """ "± 41": half of the 95 % interval, from a standard error."""
    return f"± {rounded(half_width(error, degrees), digits)}"


def rounded(value: float, digits: int) -> str:
    """A number with this many significant digits, without a power of ten if it is large:
    "16,040"."""
    return f"{float(f'{value:.{digits}g}'):,.12g}"


def with_error(value: float, error: float) -> str:
    """A number with half of its interval, which has two significant digits: "2,732 ± 21". If the
    numbers are very large or small, both share a power of ten, "(1.235 ± 0.021)e-07". Without an
    error, or with an error of the size of round-off, the number has twelve digits.
    """
    value, error = float(value) + 0.0, float(f"{error:.1e}")
    size = max((abs(x) for x in (value, error) if np.isfinite(x)), default=0.0)
    exponent = int(np.floor(np.log10(size))) if size else 0
    if exponent not in range(-5, 12):
        scaled = (float(Decimal(x).scaleb(-exponent)) for x in (value, error))
        return f"({with_error(*scaled)})e{exponent:+03d}"
    if not (np.isfinite(error) and error > ROUND_OFF * abs(value)):
        return f"{value:,.12g} ± {error:.2g}"
    positions = 1 - int(np.floor(np.log10(error)))
    displayed = round(value, positions) + 0.0
    return f"{displayed:,.{max(positions, 0)}f} ± {error:,.{max(positions, 0)}f}"


class Sampled(NamedTuple):
    """An estimate, its standard error, and the degrees of freedom of Student's t."""

    value: float
    standard_error: float
    degrees: float = np.inf

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        return with_error(self.value, half_width(self.standard_error, self.degrees))

    def interval(self, level: float = LEVEL, comparisons: int = 1) -> tuple[float, float]:
        """The limits between which the true number lies with probability `level`."""
        half = critical(self.degrees, level, comparisons) * self.standard_error
        return self.value - half, self.value + half

    def contains(self, expected: float, level: float = LEVEL, comparisons: int = 1) -> bool:
        """Whether a number lies within the interval."""
        low, high = self.interval(level, comparisons)
        return low <= expected <= high


class Estimate(NamedTuple):
    """Numbers of any shape from independent blocks of paths: `blocks` [B, *shape].

    The mean over the blocks is the estimate, and their spread gives its standard error.
    """

    blocks: np.ndarray

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        """ "2,732 ± 21"; of an array the first three."""
        halves = half_width(1.0, len(self.blocks) - 1) * self.standard_error
        numbers = zip(np.ravel(self.value).tolist(), np.ravel(halves).tolist())
        summary = [with_error(*number) for number in islice(numbers, SHOWN)]
        if self.blocks.ndim == 1:
            return summary[0]
        count = self.blocks[0].size
        return f"[{', '.join([*summary, *[f'… ({count} numbers)'] * (count > SHOWN)])}]"

    @property
    def value(self) -> np.ndarray:
        """The numbers."""
        return self.blocks.mean(0)

    @property
    def standard_error(self) -> np.ndarray:
        """The standard errors of the numbers, of the same shape; Student's t has B - 1 degrees of
        freedom."""
        return _error(self.blocks)

    def along(self, direction: np.ndarray) -> tuple[float, float]:
        """The sum of the numbers times a direction, and its standard error."""
        joined = Estimate((self.blocks * direction).reshape(len(self.blocks), -1).sum(1))
        return float(joined.value), float(joined.standard_error)

    def norm(self) -> tuple[float, float]:
        """The Euclidean norm, and the norm of the noise in it. Noise adds the sum of the squared
        standard errors to the square of a norm. This sum is subtracted; a norm below its noise may
        be zero.
        """
        noise = float(np.linalg.norm(self.standard_error))
        square = float(np.sum(self.value**2)) - noise**2
        return float(np.sqrt(max(square, 0.0))), noise


def critical(degrees: float = np.inf, level: float = LEVEL, comparisons: int = 1) -> float:
    """The number of standard errors to either side of an estimate, for intervals that hold for all
    `comparisons` estimates together.

    By Bonferroni's bound, each interval may miss with probability (1 - level) / comparisons.
    """
    from scipy import special  # late: it takes as long as reading a case

    spare = (1 - level) / max(1, comparisons)
    return float(-special.stdtrit(degrees, spare / 2)) if degrees > 0 else np.nan


def independent(*errors: float | np.ndarray) -> np.ndarray:
    """The standard error of a sum or difference of independent estimates."""
    return np.sqrt(np.sum(np.square(np.broadcast_arrays(*errors)), axis=0))


def shares(values: np.ndarray, groups: np.ndarray | None = None) -> np.ndarray:
    """[G] one number for each group, whose mean is the mean over paths. `groups` [N]: the number of
    each path's group, from 0."""
    return ratio_shares(values, np.ones(len(values)), groups)


def ratio_shares(
    top: np.ndarray, bottom: np.ndarray, groups: np.ndarray | None = None
) -> np.ndarray:
    """[G] one number for each group, whose mean is sum(top) / sum(bottom); linearised there."""
    top, bottom = np.asarray(top, np.float64), np.asarray(bottom, np.float64)
    if groups is not None:
        top, bottom = np.bincount(groups, top), np.bincount(groups, bottom)
    complete = bottom.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        value = top.sum() / complete
        if not np.isfinite(value):
            return np.full(len(top), value)
        return value + (top - value * bottom) * (len(top) / complete)


def of_shares(result: np.ndarray, fit: int = 0) -> Sampled:
    """The estimate from shares [G]; each of `fit` coefficients costs one degree of freedom."""
    degrees = len(result) - 1 - fit
    with np.errstate(invalid="ignore"):
        error = float(_error(result)) if degrees > 0 else np.nan
        value = float(np.mean(result))
    error *= float(np.sqrt((len(result) - 1) / max(degrees, 1)))
    return Sampled(value, error, max(degrees, 0))


def mean(values: np.ndarray, groups: np.ndarray | None = None) -> Sampled:
    """The mean over paths; for a difference of two runs on the same paths, the paired mean."""
    return of_shares(shares(values, groups))


class Skewed(NamedTuple):
    """A mean with a possibly asymmetric interval.

    - `standard_error`: half the width of the 95 % interval, divided by that of a standard normal
      distribution.
    - `low`, `high`: the interval; `few`: whether a few of the numbers dominate it.
    """

    value: float
    standard_error: float
    low: float
    high: float
    few: bool


def skewed_mean(values: np.ndarray, groups: np.ndarray | None = None) -> Skewed:
    """The mean over paths of numbers that a few large ones may dominate.

    Up to a skewness of 3 it is Student's interval of 32 block means. Above 3, if that interval is
    too short, it is the bootstrap-t: t-values of resampled means instead of Student's (Efron and
    Tibshirani, An Introduction to the Bootstrap, 1993, section 12.5).
    """
    block_means = shares(values, groups)
    spread = np.std(block_means)
    few = (
        len(block_means) > 2
        and spread > 0
        and np.mean((block_means - block_means.mean()) ** 3) > SKEW * spread**3
    )
    if not few:
        blocks = block_means if len(block_means) < 2 * BLOCKS else _block_means(block_means, BLOCKS)
        sampled = of_shares(blocks)._replace(value=float(block_means.mean()))
        low, high = sampled.interval()
        return Skewed(sampled.value, sampled.standard_error, low, high, False)
    block_means = _block_means(block_means, RESAMPLED)
    value, error = block_means.mean(), _error(block_means)
    selected = np.random.default_rng(0).integers(
        len(block_means), size=(RESAMPLES, len(block_means))
    )
    repeated = block_means[selected]
    errors = np.std(repeated, axis=1, ddof=1) / np.sqrt(len(block_means))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (repeated.mean(axis=1) - value) / errors
    minimum, maximum = np.quantile(t[np.isfinite(t)], [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    low, high = float(value - maximum * error), float(value - minimum * error)
    return Skewed(float(value), (high - low) / (2 * critical()), low, high, True)


def _block_means(result: np.ndarray, count: int) -> np.ndarray:
    """At most `count` means of neighbours; their mean is that of all to rounding, where they are
    of equal size."""
    count = min(count, len(result))
    complete = result[: len(result) // count * count].reshape(count, -1).mean(1)
    return complete + (result.mean() - complete.mean())


SKEW, BLOCKS = 3.0, 32
RESAMPLES, RESAMPLED = 999, 1024  # and of how many means at most


def ratio(top: np.ndarray, bottom: np.ndarray, groups: np.ndarray | None = None) -> Sampled:
    """sum(top) / sum(bottom) over paths."""
    return of_shares(ratio_shares(top, bottom, groups))


def tail(values: np.ndarray, level: float, groups: np.ndarray | None = None) -> Sampled:
    """The mean of the smallest 1 - level of the paths."""
    return mean(_in_tail(np.asarray(values), level), groups)


def _in_tail(values: np.ndarray, level: float) -> np.ndarray:
    from snapo.problem.objective import CVaR  # late: it loads JAX

    return CVaR("", level).influence({"": values})


def deviation(values: np.ndarray, groups: np.ndarray | None = None) -> Sampled:
    """The standard deviation of the paths; its error follows by linearising the square root."""
    values = np.asarray(values, np.float64)
    square = mean((values - values.mean()) ** 2, groups)
    result = float(np.sqrt(square.value))
    return Sampled(result, square.standard_error / (2 * max(result, 1e-300)), square.degrees)


def shortfall(
    values: np.ndarray, level: float, groups: np.ndarray | None = None
) -> tuple[Sampled, Sampled]:
    """The mean minus a quantile, and the mean minus the mean of the paths below that quantile.

    `level`: 0.95 for the worst 5 %. Errors are computed by influence functions. The density at the
    quantile is estimated from the quantiles at both ends of the interval of the share below it.
    """
    values = np.asarray(values, np.float64)
    share = 1 - level
    result = float(np.quantile(values, share))
    below = values <= result
    half = critical() * float(np.sqrt(share * level / len(values)))
    low, high = np.quantile(values, np.clip([share - half, share + half], 0.0, 1.0))
    at_risk = result + (high - low) / (2 * half) * (share - below)
    risk = mean(values - at_risk, groups)._replace(value=float(values.mean()) - result)
    return risk, mean(values - _in_tail(values, level), groups)


def quantile(values: np.ndarray, level: float, groups: np.ndarray | None = None) -> Sampled:
    """A quantile; its error is the inverse of the interval of the share below it (Woodruff
    1952)."""
    result = float(np.quantile(values, level))
    below = mean(np.asarray(values) <= result, groups)
    half = critical(below.degrees) * below.standard_error
    if not np.isfinite(half):
        return Sampled(result, np.nan, below.degrees)
    low, high = np.quantile(values, np.clip([level - half, level + half], 0.0, 1.0))
    return Sampled(result, float(high - low) / (2 * critical(below.degrees)), below.degrees)


def proportion(count, of: int):
    """The share of independent draws that were counted, and its standard error, as arrays of the
    same shape. The error is that with two additional draws of either kind (Agresti and Coull
    1998), since zero of a hundred draws does not imply a probability of zero.
    """
    count = np.asarray(count, np.float64)
    moved = (count + 2) / (of + 4)
    return count / of, np.sqrt(moved * (1 - moved) / (of + 4))


def controlled(
    result: np.ndarray, controls: list[np.ndarray]
) -> tuple[np.ndarray, list[int], Sampled]:
    """The shares [G] of the groups of paths minus their regression on controls of mean zero, and
    the estimate of the mean of the result.

    A control whose mean differs from zero, with a p-value below one in a million, is not used: it
    would remove a part of the value with the noise. The indices of such controls are returned.
    """
    false = []
    for i, control in enumerate(controls):
        low, high = of_shares(control).interval(1 - CHANCE, len(controls))
        none = ROUND_OFF * (np.max(np.abs(control)) + np.max(np.abs(result)))
        if not low - none <= 0 <= high + none:
            false.append(i)
    used = [item for i, item in enumerate(controls) if i not in false]
    if not used or len(result) < len(used) + 3 or not np.isfinite(result).all():
        return result, false, of_shares(result)
    design = np.stack(used, 1)
    beta = np.linalg.lstsq(design - design.mean(0), result - result.mean(), rcond=None)[0]
    left = result - design @ beta
    return left, false, of_shares(left, len(used))


CHANCE = 1e-6  # of refusing a control that is right
ROUND_OFF = 1e-12  # relative


def _error(blocks: np.ndarray) -> np.ndarray:
    """The standard error of a mean over independent rows."""
    if len(blocks) < 2:
        return np.full(np.shape(blocks)[1:], np.nan)
    return np.asarray(np.std(blocks, axis=0, ddof=1) / np.sqrt(len(blocks)))
