"""Whole numbers."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .base import ROUNDING, Actions
from .box import Box, BoxBound, BoxBounds, components


class Integers(Actions):
    """Actions that are whole numbers: `size` of them, each between its `low` and its `high`.

    In training an action may lie anywhere between its bounds; in the value it is rounded to the
    nearest whole number (a half to the even one).

    **Arguments:** as those of `BoxBounds`; a finite bound is a whole number.

    **Raises:** `ValueError` as `BoxBounds`, and for a finite bound that is no whole number.

    >>> lots = snapo.Integers(0, 10)
    >>> lots.settle(np.array([3.4]), snapo.Exact()).tolist()  # in the value
    [3.0]
    >>> round(float(snapo.Smooth(0.1).round(3.4)), 6)  # in training
    3.4
    """

    low: BoxBound = eqx.field(static=True)
    high: BoxBound = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def __init__(self, low: BoxBounds, high: BoxBounds, size: int | None = None):
        box = Box(low, high, components("Integers", low, high, size))
        for name, bound in zip(("low", "high"), box.bounds()):
            broken = bound[np.isfinite(bound) & (bound != np.round(bound))]
            if broken.size:
                raise ValueError(f"Integers: {name} is {broken[0]:g}; allowed is a whole number.")
        self.low, self.high, self.size = box.low, box.high, box.size

    @property
    def box(self) -> Box:
        """All numbers between the bounds."""
        return Box(self.low, self.high, self.size)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """[size] low and [size] high, in float64."""
        return self.box.bounds()

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """Maps unbounded numbers between the bounds, as a `BoxBounds` does; exact: rounded."""
        return self.settle(self.box.squash(raw), smooth)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """base + correction, clipped to the bounds; exact: rounded."""
        return self.settle(self.box.near(base, correction, smooth), smooth)

    @property
    def exploration_size(self) -> int:
        return self.size

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """As of a `BoxBounds`: in training numbers need not be whole."""
        return self.box.explore(action, normals, share)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return smooth.round(action)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        off = np.abs(action - np.round(action)) > ROUNDING * np.maximum(1.0, np.abs(action))
        if off.any():
            i = int(np.flatnonzero(off)[0])
            return f"Action {i} is {action[i]:g}, no whole number.", "Round it: smooth.round(…)."
        return self.box.fault(action)
