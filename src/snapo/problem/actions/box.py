"""Numbers between bounds."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from .base import ROUNDING, Actions, count

BoxBound = float | tuple[float, ...]
BoxBounds = float | Sequence[float] | np.ndarray  # as they may be given


def components(name: str, low: Any, high: Any, size: Any) -> int:
    """The number of components: `size`, else the length of the bounds, else 1."""
    if size is None:
        lengths = [len(item) for item in (low, high) if np.ndim(item)]
        size = lengths[0] if lengths else 1
    return count(f"{name}: size", size, 1, f", after the bounds: {name}(0, 1, size=2)")


def _bound(name: str, values: Any, size: int) -> BoxBound:
    """One number where all components share it, else a tuple with one for each."""
    try:
        item = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        item = np.asarray(np.nan)
    if np.isnan(item).any():
        raise ValueError(f"Box: {name} is {values!r}; allowed is a number, or one per component.")
    if item.ndim == 0:
        return float(item)
    if item.shape != (size,):
        raise ValueError(
            f"Box: {name} has shape {item.shape} and size is {size}; give one number for all "
            "components, or one for each."
        )
    # Equal sets compare equal, however they were written.
    numbers = tuple(item.tolist())
    return numbers[0] if len(set(numbers)) == 1 else numbers


class Box(Actions):
    """Actions in a box: `size` numbers, each between its `low` and its `high`.

    **Arguments:**

    - `low`, `high`: one number for all components, or an array [size] of one for each; either may
      be infinite, as in `Box(-math.inf, math.inf)`.
    - `size`: the number of components; by default that of the arrays, or 1.

    **Raises:** `ValueError` where a `low` is not below its `high`, for NaN, and for other sizes.

    >>> box = snapo.Box([0.0, -1.0], 1.0)
    >>> box.bounds()
    (array([ 0., -1.]), array([1., 1.]))
    >>> box.squash(np.zeros(2, np.float32)).tolist()  # the middle
    [0.5, 0.0]
    """

    low: BoxBound = eqx.field(static=True)
    high: BoxBound = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def __init__(self, low: BoxBounds, high: BoxBounds, size: int | None = None):
        size = components("Box", low, high, size)
        self.size = size
        self.low, self.high = _bound("low", low, size), _bound("high", high, size)
        for i, (minimum, maximum) in enumerate(zip(*self.bounds())):
            if not minimum < maximum:
                at = (
                    "" if isinstance(self.low, float) and isinstance(self.high, float) else f"[{i}]"
                )
                raise ValueError(
                    f"Box: low{at} is {minimum} and high{at} is {maximum}; low must be below high."
                )

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """[size] low and [size] high, in float64."""
        low, high = (
            np.broadcast_to(np.asarray(b, np.float64), (self.size,)) for b in (self.low, self.high)
        )
        return low.copy(), high.copy()

    @property
    def _uniform(self) -> bool:
        """Whether all components have the same bounds."""
        return isinstance(self.low, float) and isinstance(self.high, float)

    def squash(self, raw: Float[Array, " size"], smooth=None) -> Float[Array, " size"]:
        """Maps unbounded numbers into the box: the identity, a softplus or a logistic curve."""
        if self._uniform:
            return _squash(raw, self.low, self.high)
        low, high = self.bounds()
        # The components of each kind (which ends are finite) together, then in their own order.
        kinds = list(zip(np.isfinite(low).tolist(), np.isfinite(high).tolist()))
        result = jnp.zeros_like(raw)
        for kind in dict.fromkeys(kinds):
            selected = np.array([item == kind for item in kinds])
            minimum, maximum = (np.where(selected & np.isfinite(b), b, 0.0) for b in (low, high))
            endpoints = (
                jnp.asarray(minimum, raw.dtype) if kind[0] else -math.inf,
                jnp.asarray(maximum, raw.dtype) if kind[1] else math.inf,
            )
            result = jnp.where(selected, _squash(raw, *endpoints), result)
        return result

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """base + correction, clipped to the box; rounded by `smooth`, whose scale is the box's
        width, or one where that is infinite."""
        low, high = self.bounds()
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        if self._uniform:
            return smooth.clip(base + correction, self.low, self.high, scale=float(width[0]))
        low, high, width = (jnp.asarray(x, correction.dtype) for x in (low, high, width))
        return smooth.clip(base + correction, low, high, scale=width)

    @property
    def exploration_size(self) -> int:
        return self.size

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """(1 - share) action + share x, with x uniform between two bounds, or a normal's size
        beyond one; without bounds, action + share x with a normal x."""
        low, high = self.bounds()
        above, below = np.isfinite(low), np.isfinite(high)
        minimum, maximum = (
            jnp.asarray(np.where(np.isfinite(b), b, 0.0), action.dtype) for b in (low, high)
        )
        outside = jnp.where(normals < 0, -normals, normals)
        anywhere = jnp.where(above, minimum + outside, maximum - outside)
        anywhere = jnp.where(above & below, minimum + (maximum - minimum) * ndtr(normals), anywhere)
        mixed = (1 - share) * action + share * anywhere
        return jnp.where(above | below, mixed, action + share * normals)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        for i in np.flatnonzero(np.isnan(action))[:1]:
            return (
                f"Action {i} is not a number.",
                "Look for 0 / 0, or a logarithm or root of a negative number, before it.",
            )
        low, high = self.bounds()
        outside = (action < low - ROUNDING * np.abs(low)) | (
            action > high + ROUNDING * np.abs(high)
        )
        for i in np.flatnonzero(outside)[:1]:
            return (
                f"Action {i} is {action[i]:g}, outside of {low[i]:g} to {high[i]:g}.",
                "Squash or clip it: action.squash(…), smooth.clip(…).",
            )
        return None


def _squash(raw: Array, low: Any, high: Any) -> Array:
    """Into (low, high); an infinite end is a Python number."""
    above, below = (isinstance(end, float) and math.isinf(end) for end in (low, high))
    if above and below:
        return raw
    if below:
        return low + jax.nn.softplus(raw)
    if above:
        return high - jax.nn.softplus(-raw)
    return low + (high - low) * jax.nn.sigmoid(raw)
