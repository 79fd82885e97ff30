"""Black's formula: a right to withdraw on one day is a call on that day's forward price."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr


class BlackCall(NamedTuple):
    """A European call on a forward: its present value, and that value's derivative by it."""

    value: np.ndarray
    delta: np.ndarray


def black_call(forward, strike, deviation, discount=1.0) -> BlackCall:
    """Black (1976): discount x E[(F exp(deviation Z - deviation^2 / 2) - strike)+], Z normal.

    `deviation` is the standard deviation of ln S at expiry (0: the intrinsic value); all
    arguments broadcast. Prices in currency per unit. A withdrawal right on one day is such a call.
    """
    forward, strike, deviation, discount = np.broadcast_arrays(
        *(np.asarray(x, np.float64) for x in (forward, strike, deviation, discount))
    )
    live = (deviation > 0) & (strike > 0)
    width = np.where(live, deviation, 1.0)
    ratio = np.log(forward / np.where(live, strike, forward))
    upper = np.where(live, ratio / width + width / 2, np.where(forward > strike, np.inf, -np.inf))
    delta = ndtr(upper)
    exercised = ndtr(np.where(live, upper - width, upper))
    return BlackCall(discount * (forward * delta - strike * exercised), discount * delta)
