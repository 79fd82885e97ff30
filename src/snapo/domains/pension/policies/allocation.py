"""The network of a fund; actions within all limits (weights within bounds and groups, swaps backed
by collateral); and the limits of swaps in money.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Network, Policy, as_observation
from snapo.problem.problem import prepare
from snapo.problem.simulator import Schedule, Simulator, at, probe
from snapo.problem.smooth import EXACT

from ..fund.collateral import stressed
from ..fund.trading import SHARE
from ..pots.simulator import simulator_of
from ..records.case import PensionCase
from ..records.inputs import pension_inputs

MARGIN = 0.02  # of a range: a start nearer to a bound than this is moved inside, where it can learn


class AllocationLimits(Policy):
    """Turns real numbers, one per class and swap bucket, into an action within all limits.

    Weights are `smooth.simplex` of the first n numbers, which reaches every mix inside the bounds,
    including negative and levered weights if the bounds allow them. The positions of the notionals
    in their ranges are a logistic function of the other numbers. If these ranges are shares of the
    assets, all swaps are scaled down together until the collateral of the weights is sufficient. If
    they are shares of the liability, a policy does not observe enough to ensure this, and the
    simulator counts the shortfall.
    """

    low: Frozen
    high: Frozen
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    group_low: Frozen
    group_high: Frozen
    cover: "Cover | None"

    def __init__(self, case: PensionCase):
        assets, overlay = case.assets, case.overlay
        self.low, self.high = Frozen(assets.low), Frozen(assets.high)
        self.groups = tuple(group.members for group in assets.groups)
        self.group_low = Frozen(np.array([float(group.low) for group in assets.groups]))
        self.group_high = Frozen(np.array([float(group.high) for group in assets.groups]))
        self.cover = None
        if overlay is not None and overlay.unit == "assets":
            after = stressed(case, float(overlay.collateral_stress.used()))
            self.cover = Cover(
                # A copy: JAX remembers an array of the case in the type it met first.
                Frozen(overlay.low.copy()),
                Frozen(overlay.high - overlay.low),
                Frozen(after.need),
                Frozen(after.cover),
            )

    def weights(self, logits: Array, smooth) -> Float[Array, " n"]:
        """Weights within bounds and groups."""
        low, high = (jnp.asarray(item.array, logits.dtype) for item in (self.low, self.high))
        return smooth.simplex(logits, low, high, self._bounded(logits.dtype))

    def _bounded(self, kind: Any) -> list[tuple[tuple[int, ...], Array, Array]]:
        """The members and the bounds of each group."""
        low, high = (jnp.asarray(x.array, kind) for x in (self.group_low, self.group_high))
        return [(members, low[i], high[i]) for i, members in enumerate(self.groups)]

    def nearest(self, weights: Array, smooth) -> Float[Array, " n"]:
        """Weights within the limits that are close to `weights`; weights within the limits are
        unchanged."""
        low, high = (jnp.asarray(item.array, weights.dtype) for item in (self.low, self.high))
        logits = _logit(_inside(weights, low, high))
        for members, minimum, maximum in self._bounded(weights.dtype):
            of = np.array(members)
            floor = jnp.maximum(jnp.sum(low[of]), minimum)
            cap = jnp.minimum(jnp.sum(high[of]), maximum)
            # A group's sum follows from the mean of its logits, the shares in it from the rest.
            complete = _logit(_inside(jnp.sum(weights[of]), floor, cap))
            logits = logits.at[of].set(logits[of] + complete - jnp.mean(logits[of]))
        return self.weights(logits, smooth)

    def action(self, weights: Array, logits: Array | None, smooth) -> Array:
        """The action of these weights and of the swaps' logits [b], if there are any."""
        if logits is None or not logits.size:
            return weights
        positions = jax.nn.sigmoid(logits.astype(weights.dtype))
        if self.cover is not None:
            positions = self.cover(positions, weights, smooth)
        return jnp.concatenate([weights, positions])

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        count = self.low.array.shape[0]
        weights = self.weights(observation[:count], smooth)
        return self.action(weights, observation[count:], smooth)


class Cover(eqx.Module):
    """Collateral behind swaps: the ranges `low`, `width` [b] of the notionals as shares of the
    assets, and under stress `need` [b] and `cover` [n] (see `fund.collateral`)."""

    low: Frozen
    width: Frozen
    need: Frozen
    cover: Frozen

    def __call__(self, positions: Array, weights: Array, smooth) -> Float[Array, " b"]:
        """Positions of the notionals for which the collateral is sufficient; `positions` if it
        already is."""
        values = (self.low, self.width, self.need, self.cover)
        low, width, need, cover = (jnp.asarray(x.array, positions.dtype) for x in values)
        share = low + positions * width
        # Borrowed cash can exceed the eligible assets; there is no collateral then.
        there = jnp.maximum(jnp.sum(cover * weights), 0.0)
        needed = smooth.maximum(jnp.sum(need * share), there, SHARE)
        backed = share * there / jnp.where(needed > 0, needed, 1.0)
        # Swaps that have to be held stay, covered or not.
        return jnp.clip((backed - low) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)


def present(case: PensionCase) -> np.ndarray:
    """The numbers [n + b] that `AllocationLimits` maps close to the present weights and
    notionals."""
    assets, overlay = case.assets, case.overlay
    position = [_place(assets.weight.used(), assets.low, assets.high)]
    if overlay is not None:
        unit = limit_unit(case)
        share = overlay.notional.used() / np.where(unit > 0, unit, 1.0)
        position.append(_place(share, overlay.low, overlay.high))
    inside = np.clip(np.concatenate(position), MARGIN, 1 - MARGIN)
    return np.log(inside / (1 - inside)).astype(np.float32)


def logits_of(case: PensionCase, weights: np.ndarray) -> np.ndarray:
    """The numbers [n] from which `AllocationLimits` makes these weights, if no group limits
    them."""
    inside = np.clip(_place(weights, case.assets.low, case.assets.high), 1e-3, 1 - 1e-3)
    return np.log(inside / (1 - inside))


def _place(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.where(high > low, (values - low) / np.where(high > low, high - low, 1.0), 0.5)


def _inside(x: Array, low: Array, high: Array) -> Array:
    """The position of x in its range, away from both ends."""
    width = high - low
    return jnp.clip((x - low) / jnp.where(width > 0, width, 1.0), 1e-4, 1 - 1e-4)


def _logit(x: Array) -> Array:
    return jnp.log(x / (1 - x))


class PensionPolicy(Policy):
    """A network around the present holdings of the fund.

    **Arguments:**

    - `features`: size of the observation; `hidden`: widths of the hidden layers.
    """

    network: Network
    limits: AllocationLimits
    start: Frozen

    def __init__(self, case: PensionCase, features: int, *, key, hidden: tuple[int, ...]):
        start = present(case)
        widths = (features, *hidden, len(start))
        self.network = Network(widths, key=key, activation=jax.nn.tanh)
        self.limits, self.start = AllocationLimits(case), Frozen(start)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        start = jnp.asarray(self.start.array, observation.dtype)
        return self.limits(start + self.network(observation), smooth)


def new_policy(case: PensionCase, simulator: Simulator, schedule: Schedule, key) -> PensionPolicy:
    """The network of a case, untrained: it approximately keeps the present holdings."""
    features = probe(simulator, schedule)[1].shape[0]
    return PensionPolicy(case, features, key=key, hidden=case.hidden)


def notionals(case: PensionCase, positions: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The notionals [b] of the policy, from their `positions` (0 to 1) in the ranges.

    `values`: [b] the money to which limits refer (see `limit_unit`).
    """
    overlay = case.overlay
    if overlay is None:
        return np.zeros(0)
    shares = overlay.low + positions * (overlay.high - overlay.low)
    requested = shares * values
    assets = float(case.assets.amount.used())
    total, maximum = np.abs(requested).sum() / assets, float(overlay.leverage.used())
    return requested * min(1.0, maximum / total) if total > 0 else requested


def limit_unit(case: PensionCase) -> np.ndarray:
    """The amounts of money today [b] of which the limits of swaps are shares: all assets, or the
    value of the payments nearest to each bucket, which for personal pots are those that the pots
    pay for."""
    if case.overlay is None or case.overlay.unit == "assets":
        return np.full(case.buckets, float(case.assets.amount.used()))
    simulator = simulator_of(case)
    schedule = prepare(simulator, pension_inputs(case))
    terms, now = schedule.constants, at(schedule.steps, 0)
    with jax.enable_x64(True):
        state = simulator.initial(terms, jnp.zeros(simulator.initial_noise_size))
        return np.asarray(simulator.payments_near(terms, now, state))
