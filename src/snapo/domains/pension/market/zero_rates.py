"""Quotes of a curve as continuous zero rates, and back."""

import numpy as np

from ..records.market import Curve


def zero_rates(curve: Curve) -> np.ndarray:
    """[n] continuous zero rates at the nodes, whatever is quoted."""
    if curve.quote == "zero":
        return curve.rate.used()
    return np.cumsum(curve.rate.used() * np.diff(curve.tenor, prepend=0.0)) / curve.tenor


def from_zero_rates(curve: Curve, zero: np.ndarray) -> np.ndarray:
    """The quotes of these zero rates: the inverse of `zero_rates`."""
    if curve.quote == "zero":
        return zero
    return np.diff(zero * curve.tenor, prepend=0.0) / np.diff(curve.tenor, prepend=0.0)
