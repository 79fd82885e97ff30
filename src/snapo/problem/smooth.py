"""Hard constraints from one definition: smooth in training, exact in the value.

A simulator and a policy receive `smooth` and write their limits with it::

    volume = smooth.minimum(rate, room, scale=25.0)
    fraction = smooth.indicator(value - price, scale=1.0)

With `Smooth(temperature)` every corner is rounded over a width of temperature times scale,
`scale` being in the units of the argument; with `Exact()` the same code gives the exact rules. The
temperature is an array, so annealing it never recompiles.

Corners (`positive_part`, `minimum`, `maximum`, `clip`, `absolute`) are rounded by a quartic of
compact support: outside the width they equal the exact function, and a smooth minimum never
exceeds the exact one, so that feasible volumes stay feasible. Jumps (`indicator`, `choose`,
`share`) become logistic curves, whose tails have a slope towards the better side.
All are finite in value and first and second derivative at the kink, at equal arguments, at
infinities and at temperature zero: the unused branch is evaluated at a safe point.
"""

import abc
from collections.abc import Sequence

from .record import TreeRecord, field
from .record.arrays import Array, ArrayLike, Float, custom_jvp, jax
from .record.either import updated, xp


class Constraints(TreeRecord):
    """The operations of limits; `Smooth` and `Exact` differ in few of them."""

    @abc.abstractmethod
    def positive_part(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """max(x, 0). The smooth form is w (u + 1)^3 (3 - u) / 16 with u = x / w where |x| < w =
        temperature * scale. It is twice differentiable, and above the exact form by at most 3 w /
        16, at x = 0."""

    @abc.abstractmethod
    def indicator(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """1 if x > 0, else 0. The smooth form is 1 / (1 + exp(-x / w)), with an error of at most
        exp(-|x| / w)."""

    @abc.abstractmethod
    def share(self, first: ArrayLike, last: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """The share, 0 to 1, of a segment on which a line from `first` to `last` is positive.

        The smooth form is the mean of the logistic `indicator` along the segment, w (log(1 +
        e^(first / w)) - log(1 + e^(last / w))) / (first - last), with an error of at most 2 w
        log(2) / |first - last|.
        """

    @abc.abstractmethod
    def weights(self, scores: Float[Array, " n"], scale: ArrayLike = 1.0) -> Float[Array, " n"]:
        """Weight 1 on the largest score, 0 on the others. The smooth form is softmax(scores /
        w)."""

    @abc.abstractmethod
    def round(self, x: ArrayLike) -> Array:
        """The whole number nearest to x; a half goes to the even one. The smooth form is x
        itself."""

    def absolute(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """|x| = 2 max(x, 0) - x. The smooth form is above |x| by at most 3 w / 8, at x = 0."""
        return 2 * self.positive_part(x, scale) - x

    def minimum(self, a: ArrayLike, b: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """min(a, b) = a - max(a - b, 0). The smooth form is lower by at most 3 w / 16, at a = b."""
        gap, finite = _finite_difference(a, b)
        return xp.where(finite, a - self.positive_part(gap, scale), xp.minimum(a, b))

    def maximum(self, a: ArrayLike, b: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """max(a, b) = b + max(a - b, 0). The smooth form is higher by at most 3 w / 16, at a =
        b."""
        gap, finite = _finite_difference(a, b)
        return xp.where(finite, b + self.positive_part(gap, scale), xp.maximum(a, b))

    def clip(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        """x clipped to [low, high], low <= high. The smooth form is also within the limits, with
        an error of at most 3 w / 16. If the limits are closer than w, the corners are rounded over
        high - low: wider corners would overlap, and results could be outside of the limits.
        """
        return self.minimum(self.maximum(x, low, scale), high, scale)

    def choose(
        self, scores: Float[Array, " n"], options: Float[Array, "n ..."], scale: ArrayLike = 1.0
    ) -> Array:
        """The option with the largest score. The smooth form is the softmax-weighted mean of all
        options."""
        return xp.tensordot(self.weights(scores, scale), options, axes=1)

    def simplex(
        self,
        logits: Float[Array, " n"],
        low: ArrayLike = 0.0,
        high: ArrayLike = 1.0,
        groups: Sequence[tuple[Sequence[int], ArrayLike, ArrayLike]] = (),
        total: ArrayLike = 1.0,
    ) -> Float[Array, " n"]:
        """Shares within bounds that add up to `total`, from any real numbers, by construction.

        w_i = low_i + (high_i - low_i) / (1 + exp(-(logits_i + level))), where the level is the
        number with which they add up to `total`. This is smooth, so it is the same for `Smooth`
        and `Exact`.

        **Arguments:**

        - `groups`: disjoint `(members, low, high)`: the members' sum lies within [low, high].
          Group sums are computed first, by the same formula on the groups' mean logits, then
          shares within each group; an asset without a group forms its own.
        - Bounds must be attainable: sum(low) <= total <= sum(high), in every group too.
        """
        n = logits.shape[0]
        low, high = (xp.broadcast_to(xp.asarray(b, logits.dtype), (n,)) for b in (low, high))
        if not groups:
            return _fill(logits, low, high, xp.asarray(total, logits.dtype))
        members = [xp.asarray(g[0]) for g in groups]
        grouped = {int(i) for g in groups for i in g[0]}
        if len(grouped) < sum(len(g[0]) for g in groups):
            raise ValueError("simplex: an asset is in two groups; groups must be disjoint.")
        alone = xp.asarray([i for i in range(n) if i not in grouped], int)
        mean = xp.stack([logits[m].mean() for m in members])
        floor = xp.stack([xp.maximum(low[m].sum(), g[1]) for m, g in zip(members, groups)])
        cap = xp.stack([xp.minimum(high[m].sum(), g[2]) for m, g in zip(members, groups)])
        sums = _fill(
            xp.concatenate([mean, logits[alone]]),
            xp.concatenate([floor, low[alone]]),
            xp.concatenate([cap, high[alone]]),
            xp.asarray(total, logits.dtype),
        )
        shares = updated(xp.zeros_like(logits), alone, sums[len(groups) :])
        for group_sum, m in zip(sums, members):
            shares = updated(shares, m, _fill(logits[m], low[m], high[m], group_sum))
        return shares


class Smooth(Constraints):
    """Constraints smoothed at `temperature` (an array; zero gives the exact ones).

    >>> round(float(snapo.Smooth(0.1).minimum(1.0, 1.0, scale=2.0)), 6)  # below by 3/16 of 0.2
    0.9625
    >>> float(snapo.Smooth(0.1).minimum(1.0, 3.0, scale=2.0))  # farther apart than 0.2: exact
    1.0
    """

    temperature: Array = field(converter=lambda x: xp.asarray(x))

    def positive_part(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        width = self.temperature * scale
        rounded = xp.abs(x) < width
        u = xp.where(rounded, x, 0.0) / xp.where(width > 0, width, 1.0)
        corner = width * (u + 1) ** 3 * (3 - u) / 16
        return xp.where(rounded, corner, xp.where(xp.asarray(x) < 0, 0.0, x))

    def clip(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        room, finite = _finite_difference(high, low)
        narrow = finite & (self.temperature * scale > room)
        minimum = xp.where(narrow, room, 0.0) / xp.where(narrow, self.temperature, 1.0)
        return super().clip(x, low, high, xp.where(narrow, minimum, scale))

    def indicator(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        scaled, hot = self._scaled(x, scale)
        return xp.where(hot, jax.nn.sigmoid(scaled), _step(x))

    def share(self, first: ArrayLike, last: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        a, hot = self._scaled(first, scale)
        b, _ = self._scaled(last, scale)
        wide = xp.abs(a - b) > 0.4
        gap = xp.where(wide, a - b, 1.0)
        quotient = (jax.nn.softplus(a) - jax.nn.softplus(b)) / gap
        # Nearly equal ends: the quotient loses digits, three Gauss points are exact to 1e-9.
        mid, half = (a + b) / 2, (a - b) / 2 * 0.7745966692414834
        gauss = 4 * jax.nn.sigmoid(mid) / 9
        gauss += 5 * (jax.nn.sigmoid(mid - half) + jax.nn.sigmoid(mid + half)) / 18
        return xp.where(hot, xp.where(wide, quotient, gauss), Exact().share(first, last))

    def weights(self, scores: Float[Array, " n"], scale: ArrayLike = 1.0) -> Float[Array, " n"]:
        # Gaps first: where a compiler rounds quotient and difference together, the largest quotient
        # minus itself is its round-off, of which large scores have more than exp can take.
        gaps = scores - jax.lax.stop_gradient(xp.max(scores))
        scaled, hot = self._scaled(gaps, scale)
        return xp.where(hot, jax.nn.softmax(scaled), Exact().weights(scores))

    def round(self, x: ArrayLike) -> Array:
        return xp.where(self.temperature > 0, x, xp.round(x))

    def _scaled(self, x, scale) -> tuple[Array, Array]:
        """x / (temperature * scale) and whether the temperature is above zero."""
        width = self.temperature * scale
        hot = width > 0
        return xp.where(hot, x, 0.0) / xp.where(hot, width, 1.0), hot


class Exact(Constraints):
    """The exact constraints, as in the contract.

    >>> float(snapo.Exact().clip(7.5, 0.0, 5.0))
    5.0
    >>> [float(snapo.Exact().indicator(x)) for x in (-0.1, 0.0, 0.1)]
    [0.0, 0.0, 1.0]
    """

    def positive_part(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        x = xp.asarray(x)
        return xp.where(x < 0, xp.zeros_like(x), x)

    def indicator(self, x: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        return _step(x)

    def share(self, first: ArrayLike, last: ArrayLike, scale: ArrayLike = 1.0) -> Array:
        first, last = xp.asarray(first), xp.asarray(last)
        crossing = (first > 0) != (last > 0)
        gap = xp.where(crossing, first - last, 1.0)
        positive = xp.maximum(first, 0.0) - xp.maximum(last, 0.0)
        return xp.where(crossing, positive / gap, _step(first))

    def weights(self, scores: Float[Array, " n"], scale: ArrayLike = 1.0) -> Float[Array, " n"]:
        return jax.nn.one_hot(xp.argmax(scores), scores.shape[0], dtype=scores.dtype)

    def round(self, x: ArrayLike) -> Array:
        return xp.round(x)


EXACT = Exact()


def _step(x: ArrayLike) -> Array:
    x = xp.asarray(x)
    return (x > 0).astype(xp.result_type(x, xp.float32) if x.dtype.kind != "f" else x.dtype)


def _finite_difference(a: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """a - b if that is finite, else 0, and whether it was."""
    finite = xp.isfinite(xp.asarray(a) - xp.asarray(b))
    return xp.where(finite, a, 0.0) - xp.where(finite, b, 0.0), finite


def _fill(logits: Array, low: Array, high: Array, total: Array) -> Array:
    """low + (high - low) logistic(logits + level), adding up to `total`."""
    # Only differences count; extreme ones are cut, so that the level is always found.
    middle = jax.lax.stop_gradient(xp.max(logits) + xp.min(logits)) / 2
    logits = xp.clip(logits - middle, -FARTHEST, FARTHEST)
    level = _level(logits, low, high, total)
    return low + (high - low) * jax.nn.sigmoid(logits + level)


FARTHEST = 250.0  # from the middle logit


def _slopes(x: Array, low: Array, high: Array) -> Array:
    return (high - low) * jax.nn.sigmoid(x) * jax.nn.sigmoid(-x)


def _level_derivative(primals, tangents):
    """Implicit differentiation of sum(shares) = total."""
    logits, low, high, total = primals
    d_logits, d_low, d_high, d_total = tangents
    level = _level(logits, low, high, total)
    slopes, part = _slopes(logits + level, low, high), jax.nn.sigmoid(logits + level)
    moved = xp.sum(slopes * d_logits + (1 - part) * d_low + part * d_high) - d_total
    slope = xp.sum(slopes)
    return level, xp.where(slope > 0, -moved / xp.where(slope > 0, slope, 1.0), 0.0)


@custom_jvp(_level_derivative)
def _level(logits: Array, low: Array, high: Array, total: Array) -> Array:
    """The level at which `_fill` adds up: bisection, then Newton, in a fixed number of steps."""

    def excess(level):
        return xp.sum(low + (high - low) * jax.nn.sigmoid(logits + level)) - total

    def halve(_, bracket):
        left, right = bracket
        middle = (left + right) / 2
        above = excess(middle) > 0
        return xp.where(above, left, middle), xp.where(above, middle, right)

    def newton(_, level):
        slope = xp.sum(_slopes(logits + level, low, high))
        moved = level - excess(level) / xp.where(slope > 0, slope, 1.0)
        return xp.where(slope > 0, xp.clip(moved, left, right), level)

    # Of the shares' places in their ranges, the mean is known: the largest logit's lies above it,
    # the smallest's below.
    tiny, width = xp.finfo(logits.dtype).tiny, xp.sum(high - low)
    mean = (total - xp.sum(low)) / xp.where(width > 0, width, 1.0)
    position = xp.log(xp.maximum(mean, tiny)) - xp.log(xp.maximum(1 - mean, tiny))
    bracket = (position - xp.max(logits), position - xp.min(logits))
    # 11 halvings leave an error e of an eighth at most. The sum's curvature is at most its slope,
    # so that each Newton step leaves about e^2 / 2: 1e-2, 3e-5, 1e-9, 1e-18.
    left, right = jax.lax.fori_loop(0, 11, halve, bracket)
    steps = 3 if logits.dtype == xp.float32 else 4
    return jax.lax.fori_loop(0, steps, newton, (left + right) / 2)
