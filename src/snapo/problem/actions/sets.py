"""Sets of numbers: a box, whole numbers, shares that sum to one; the base class of action sets."""

import abc
import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from ..quickly import compiled_sooner


def count(name: str, values: Any, minimum: int, more: str = "") -> int:
    """A whole number of at least `minimum`.

    **Raises:** `ValueError` for anything else; `more` is added to its message.
    """
    available = isinstance(values, int | np.integer) and not isinstance(values, bool)
    if not available or values < minimum:
        raise ValueError(
            f"{name} is {values!r}; it must be a whole number of at least {minimum}{more}."
        )
    return int(values)


class Actions(eqx.Module):
    """The set of a decision of `size` numbers, with a map into it from unbounded numbers.

    A set has two forms. The smooth form, used in training, has a derivative everywhere; the exact
    form, used in the value, contains the decisions that can be taken. `smooth` selects the form, as
    in a simulator.
    """

    size: eqx.AbstractVar[int]

    @abc.abstractmethod
    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """Maps unbounded numbers into the set."""

    @abc.abstractmethod
    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """`base` plus an unbounded correction, mapped back into the set."""

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """The action of the exact set nearest to one of the smooth set; in training, unchanged."""
        return action

    @property
    def exploration_size(self) -> int:
        """Number of normals used by `explore`; 0 for a set whose smooth form explores by itself."""
        return 0

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """A random action of the smooth set, mixed with `action` by this share, 0 to 1."""
        return action

    @abc.abstractmethod
    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        """The reason why these numbers are not in the exact set, with a remedy, or None."""

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """[size] low and [size] high, in float64; by default 0 and 1."""
        return np.zeros(self.size), np.ones(self.size)

    def together(self) -> list[list[int]]:
        """Groups of components that depend on each other; by default each is separate."""
        return [[i] for i in range(self.size)]


ROUNDING = 1e-5  # of a bound, in float32


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
        raise ValueError(f"Box: {name} is {values!r}; it must be a number, or one per component.")
    if item.ndim == 0:
        return float(item)
    if item.shape != (size,):
        raise ValueError(
            f"Box: {name} has shape {item.shape}, but size is {size}; specify one number for all "
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

    **Raises:** `ValueError` if a `low` is not below its `high`, for NaN, and for other sizes.

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
        """base + correction, clipped to the box; the corners are rounded by `smooth`, whose scale
        is the box's width, or one if that is infinite."""
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
        """(1 - share) action + share x, with x uniform between two bounds, or at a distance from a
        single bound that is the absolute value of a normal. Without bounds it is action + share x
        with a normal x."""
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
                "Look for 0 / 0, or a logarithm or root of a negative number, in the code that "
                "computes it.",
            )
        low, high = self.bounds()
        outside = (action < low - ROUNDING * np.abs(low)) | (
            action > high + ROUNDING * np.abs(high)
        )
        for i in np.flatnonzero(outside)[:1]:
            return (
                f"Action {i} is {action[i]:g}, outside of {low[i]:g} to {high[i]:g}.",
                "Squash or clip it: use action.squash(…) or smooth.clip(…).",
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


class Simplex(Actions):
    """Actions on the probability simplex: `size` numbers, none negative, that sum to one.

    >>> snapo.Simplex(4).squash(np.zeros(4)).tolist()
    [0.25, 0.25, 0.25, 0.25]
    """

    size: int = eqx.field(static=True)

    def __init__(self, size: int):
        self.size = count("Simplex: size", size, 2, ", the number of shares")

    def squash(self, raw: Float[Array, " size"], smooth=None) -> Float[Array, " size"]:
        """Maps unbounded numbers onto the simplex by a softmax."""
        return jax.nn.softmax(raw)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """Shares whose logarithms are those of `base` plus a correction."""
        return jax.nn.softmax(jnp.log(jnp.maximum(base, 1e-6)) + correction)

    @property
    def exploration_size(self) -> int:
        return self.size

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """(1 - share) action + share x, with shares x whose logarithms are normals times 2."""
        return (1 - share) * action + share * jax.nn.softmax(2 * normals)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        if np.all(action >= -ROUNDING) and abs(action.sum() - 1) <= 100 * ROUNDING:
            return None
        return (
            f"Its shares are {np.round(action, 4).tolist()}.",
            "A Simplex takes shares of at least 0 that sum to 1: use action.squash(…).",
        )

    def together(self) -> list[list[int]]:
        return [list(range(self.size))]


class Integers(Actions):
    """Actions that are whole numbers: `size` of them, each between its `low` and its `high`.

    In training an action may lie anywhere between its bounds; in the value it is rounded to the
    nearest whole number (a half to the nearest even number).

    **Arguments:** as for `Box`; finite bounds are whole numbers.

    **Raises:** `ValueError` as for `Box`, and for a finite bound that is not a whole number.

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
                raise ValueError(f"Integers: {name} is {broken[0]:g}; it must be a whole number.")
        self.low, self.high, self.size = box.low, box.high, box.size

    @property
    def box(self) -> Box:
        """All numbers between the bounds."""
        return Box(self.low, self.high, self.size)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """[size] low and [size] high, in float64."""
        return self.box.bounds()

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """Maps unbounded numbers between the bounds, as a `Box` does; in the exact set they are
        rounded."""
        return self.settle(self.box.squash(raw), smooth)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """base + correction, clipped to the bounds; in the exact set it is rounded."""
        return self.settle(self.box.near(base, correction, smooth), smooth)

    @property
    def exploration_size(self) -> int:
        return self.size

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """As for a `Box`, since in training numbers need not be whole."""
        return self.box.explore(action, normals, share)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return smooth.round(action)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        off = np.abs(action - np.round(action)) > ROUNDING * np.maximum(1.0, np.abs(action))
        if off.any():
            i = int(np.flatnonzero(off)[0])
            return (
                f"Action {i} is {action[i]:g}, which is not a whole number.",
                "Round it: smooth.round(…).",
            )
        return self.box.fault(action)


@compiled_sooner
def squashed(action: Actions, raw: Any, smooth: Any) -> Float[Array, "... size"]:
    """`action.squash` of many unbounded numbers [..., size] at once, compiled as a whole."""
    rows = jax.vmap(lambda row: action.squash(row, smooth))(raw.reshape(-1, action.size))
    return rows.reshape(raw.shape)
