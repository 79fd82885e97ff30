"""Zero-coupon prices from a quoted curve; break-evens have the same form."""

from typing import Any

import numpy as np

from snapo.problem.record.arrays import Array, Float
from snapo.problem.record.either import xp

from ..records.inputs import use
from ..records.market import MarketCurve
from . import smith_wilson


def log_bond(curve: MarketCurve, inputs: dict[str, Any], years: np.ndarray) -> Float[Array, " n"]:
    """ln P(0, t) at times `years` [n] >= 0; for break-evens, minus the logarithm of the expected
    index. For zero rates it is -z(t) t, with z linear between nodes and flat before the first. For
    forward rates it is minus their integral. Beyond the last node it is as
    `MarketCurve.extrapolation` specifies; "smith-wilson" determines the whole curve.
    """
    years, nodes = np.asarray(years, float), curve.tenor
    rate = use(inputs, curve.rate)
    if curve.extrapolation == "smith-wilson":
        return smith_wilson.log_bond(curve, rate, use(inputs, curve.ultimate), years)
    if curve.quote == "zero":
        at_nodes = -rate * nodes
        inside = -_between(nodes, rate, years) * np.minimum(years, nodes[-1])
    else:
        at_nodes = -xp.cumsum(rate * np.diff(nodes, prepend=0.0))
        from_zero = xp.concatenate([xp.zeros(1), at_nodes])
        inside = _between(np.concatenate([[0.0], nodes]), from_zero, years)
    outside = np.maximum(years - nodes[-1], 0.0)
    forward = rate[0]
    if len(nodes) > 1:
        forward = (at_nodes[-2] - at_nodes[-1]) / (nodes[-1] - nodes[-2])
    if curve.extrapolation == "flat-forward":
        return inside - forward * outside
    assert curve.speed is not None
    # The forward rate moves from the last one to the ultimate one by exp(-speed * beyond).
    fading = -np.expm1(-curve.speed * outside) / curve.speed
    return inside - forward * fading - use(inputs, curve.ultimate) * (outside - fading)


def _between(nodes: np.ndarray, values: Array, at: np.ndarray) -> Array:
    """Linear interpolation, flat outside; every value at a node is only that of the node."""
    upper = np.clip(np.searchsorted(nodes, at), 0, len(nodes) - 1)
    lower = np.maximum(upper - 1, 0)
    width = np.where(upper > lower, nodes[upper] - nodes[lower], 1.0)
    share = np.clip((nodes[upper] - at) / width, 0.0, 1.0) * (upper > lower)
    return xp.asarray(share) * values[lower] + (1 - share) * values[upper]
