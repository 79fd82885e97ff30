"""First settings of a PI controller from a step response: SIMC, and Ziegler and Nichols.

Both read a process as k exp(-theta s) / (tau s + 1). A controller that decides every dt holds
its output for half of that on average, which counts as dead time.
"""

from typing import NamedTuple

import numpy as np

LAGS, DEADS = 60, 41  # time constants and dead times tried
LONGEST = 20.0  # time constants of that many horizons are tried: a process that integrates


class FirstOrder(NamedTuple):
    """k exp(-theta s) / (tau s + 1): `gain` k, `lag` tau and `dead` theta in s."""

    gain: float
    lag: float
    dead: float


def first_order(times: np.ndarray, response: np.ndarray, step: float) -> FirstOrder:
    """The process that fits a response [n] at `times` s [n] after a step of this size best.

    By least squares over time constants and dead times, each with its best gain.

    **Raises:** `ValueError` where nothing responds.
    """
    times, response = np.asarray(times, float), np.asarray(response, float)
    if not np.isfinite(response).all() or np.abs(response).max() < 1e-9 * abs(step):
        raise ValueError("the reading does not answer to what is moved")
    end = times[-1]
    lags = np.geomspace(end / len(times) / 4, LONGEST * end, LAGS)
    dead = np.linspace(0.0, 0.75 * end, DEADS)
    after = np.maximum(times - dead[:, None, None], 0.0)
    shape = -np.expm1(-after / lags[:, None])  # [dead, lag, n]
    square = (shape**2).sum(-1)
    gain = np.where(square > 0, (shape @ response) / np.where(square > 0, square, 1.0), 0.0)
    missed = ((response - gain[..., None] * shape) ** 2).sum(-1)
    i, j = np.unravel_index(np.argmin(missed), missed.shape)
    return FirstOrder(float(gain[i, j] / step), float(lags[j]), float(dead[i]))


def simc(process: FirstOrder, closed: float | None = None) -> tuple[float, float]:
    """Gain and integral time in s: Kc = tau / k / s and Ti = min(tau, 4 s), s = tau_c + theta.

    `closed`: tau_c in s, by default theta. S. Skogestad, J. Process Control 13 (2003) 291.
    """
    wanted = process.dead if closed is None else closed
    room = wanted + process.dead
    return process.lag / process.gain / room, min(process.lag, 4 * room)


def ziegler_nichols(process: FirstOrder) -> tuple[float, float]:
    """Gain and integral time in s: Kc = 0.9 tau / (k theta), Ti = theta / 0.3.

    From the reaction curve. J. G. Ziegler and N. B. Nichols, Trans. ASME 64 (1942) 759.
    """
    return 0.9 * process.lag / process.gain / process.dead, process.dead / 0.3


FORMULAS = {"simc": simc, "ziegler-nichols": ziegler_nichols}
