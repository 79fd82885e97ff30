"""When the whole horizon is chaotic, and windows (`solver.windows`) that are not.

On a chaotic horizon adjoints grow a hundredfold and more on their way back, and differently on
every path, so that a few paths drown all others: the gradient is noise however it is clipped. On a
plant that is unstable and no more, they grow alike on all paths. It shows in the norms of the first
gradients, which leap up and down from one step to the next, at no cost; only then the adjoints of
some paths are measured. A window is half as long again as their largest stays near the usual one.
No unit enters.
"""

from collections.abc import Sequence

import numpy as np

FIRST = 20  # steps of training after which the norms are judged
ERRATIC = 0.3  # typical change of a norm's logarithm: below .15 on tame problems, above .4 in chaos
GROWTH = 100.0  # times that the adjoint grows from the last step to where it is largest
LEFT = 1 / 3  # of an adjoint after the steps in which it would grow so much
TAILS = 9.0  # largest of 256 paths to the usual one at a typical step: to 7 where tame, from 10 up
APART = 10.0  # the same at the step up to which paths agree
LONGER = 1.5  # a window over that: without, 2 of a Pendulum's first 6 seeds failed
SHORTEST = 5
USUAL = 5  # of the first norms, and of the last ones, whose median counts
MANY = 64  # paths whose gradient has little noise


def erratic(norms: Sequence[float], paths: int = MANY) -> bool:
    """Whether the norms of successive gradients, of so many paths each, leap up and down."""
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.abs(np.diff(np.log(np.asarray(norms, float))))
    # Few paths leave noise in the gradient of a tame problem too.
    limit = ERRATIC * max(1.0, MANY / paths) ** 0.5
    return bool(changes.size and np.median(changes) > limit)


def wild(norms: Sequence[float], paths: int = MANY) -> bool:
    """Whether the first gradients show chaos: they are erratic, or one of them fell far."""
    result = np.asarray(norms, float)
    return bool(np.any(result * GROWTH < np.maximum.accumulate(result))) or erratic(norms, paths)


def fell(norms: Sequence[float]) -> bool:
    """Whether gradients fell for good: training leaves what was wild by itself."""
    result = np.asarray(norms, float)
    return bool(np.median(result[-USUAL:]) * GROWTH < np.median(result[:USUAL]))


def window(norms: np.ndarray) -> int | None:
    """The length of windows for adjoints of these norms [T, N]; None for the whole horizon."""
    norms = _finite(norms)
    usual = np.median(norms, axis=1)
    observed = usual > 0
    if not observed.any() or not grows(norms):
        return None
    tails = norms.max(1)[observed] / usual[observed]
    if not np.median(tails) > TAILS:
        return None
    return _agreeing(norms)


def grows(norms: np.ndarray) -> bool:
    """Whether adjoints of these norms [T, N] grow a hundredfold on their way back."""
    size = np.sqrt(np.mean(_finite(norms) ** 2, axis=1))
    return bool(size[-1] * GROWTH < size.max())


def share(norms: np.ndarray) -> float:
    """The share of an adjoint that goes on at each step back (`Clip.keep`), from norms [T, N]: a
    third is left after the steps in which they grow a hundredfold; 1 where they do not.

    A third, not a hundredth: a cart that swings its pole up ends at -63 to -66 with a third and at
    -64 to -66 with a hundredth (-66 to -93 without), a quadrotor at -37.9 and -39.7 (-37.7).
    """
    back = np.sqrt(np.mean(_finite(norms) ** 2, axis=1))[::-1]
    over = np.flatnonzero(back > GROWTH * back[0])
    return float(LEFT ** (1 / over[0])) if over.size else 1.0


def _finite(norms: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(norms), norms, np.finfo(float).max ** 0.25)


def _agreeing(norms: np.ndarray) -> int | None:
    """The number of steps from the end after which paths do not agree any more."""
    back = norms[::-1]
    usual = np.maximum(np.median(back, axis=1), np.finfo(float).tiny)
    apart = np.flatnonzero(back.max(1) > APART * usual)
    length = max(SHORTEST, int(LONGER * apart[0]) if apart.size else len(back))
    return length if 2 * length <= len(back) else None
