"""The interval of a probability that was counted on independent draws."""

import numpy as np
from scipy.special import ndtri

LEVEL = 0.95


def interval(share, of: int, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest probability supported by the `share` of a number of draws (Wilson 1927).

    It is of use near 0 and 1 too: of 128 draws that all hold, the lowest is 0.971.
    """
    z = ndtri((1 + level) / 2)
    p = np.asarray(share, np.float64)
    middle = (p + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    # Round-off must not make a share of 0 or 1 lie outside its own interval.
    return np.clip(middle - half, 0.0, p), np.clip(middle + half, p, 1.0)


def draws_for(probability: float, level: float = LEVEL) -> int:
    """The number of draws, all successful, for which the interval is above a probability."""
    z = ndtri((1 + level) / 2)
    return int(np.ceil(z**2 * probability / (1 - probability)))
