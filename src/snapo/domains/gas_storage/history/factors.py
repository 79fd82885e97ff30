"""The price factors that spot prices so far make likely: a Kalman filter along a contract.

A spot price is one number, and a model may have several factors. With df_i = -a_i f_i dt + dW_i and
exact prices y(t) = sum_i s_i(t) f_i(t), the mean of the factors given all prices until t is linear
in them, and its gains depend on the model only.
"""

from typing import NamedTuple

import numpy as np

from snapo.problem.problem import Problem

from ..setup import factors

ROOM = 1e-10  # variance of the fast factor, for a first price that is not the forward price


class SpotFilter(NamedTuple):
    """`gain` and `decay` [T, F]: of the price of a day, and of the factors since the day before."""

    gain: np.ndarray
    decay: np.ndarray


def spot_filter(problem: Problem) -> SpotFilter | None:
    """The filter of a problem; None where prices have other risks than Gaussian factors."""
    model = factors(problem)
    if model is None or not model.exact or model.spikes is not None:
        return None
    size = model.decay.shape[1]
    covariance, gains = np.zeros((size, size)), []
    for loading, decay, shock in zip(model.loading, model.decay, model.shock):
        covariance = np.outer(decay, decay) * covariance + shock @ shock.T
        covariance[model.fast, model.fast] += ROOM
        along = covariance @ loading
        variance = float(loading @ along)
        gain = along / variance if variance > 0 else np.zeros(size)
        covariance = covariance - np.outer(gain, along)
        gains.append(gain)
    return SpotFilter(np.array(gains), np.asarray(model.decay))
