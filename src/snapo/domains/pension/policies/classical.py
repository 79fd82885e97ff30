"""Classical policies with parameters that can be tuned, and the present mix."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Policy, as_observation
from snapo.problem.quickly import compiled_sooner
from snapo.problem.smooth import EXACT, Exact

from ..fund.observation import RATIO, slots
from ..records.case import PensionCase
from .allocation import AllocationLimits, limit_unit, logits_of, present

WIDTH = 0.1  # of funding ratios, over which corners are rounded while tuning
MINIMUM = 1e-3  # a class of less weight is tuned from this one, where it can still learn
NEEDED = ("time", "weights")  # of the observation: year ends and holdings
UNIT = 0.1  # of shares and funding ratios: in it they are tuned by steps as large as logits


class ConstantMix(Policy):
    """Constant weights and swaps: `logits` [n + b] (see `AllocationLimits`)."""

    limits: AllocationLimits
    logits: Array

    def __init__(self, case: PensionCase, weights: np.ndarray | None = None):
        self.limits = AllocationLimits(case)
        start = present(case)
        if weights is not None:
            start[: len(weights)] = logits_of(case, weights)
        self.logits = jnp.asarray(start, jnp.float32)

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        return self.limits(self.logits.astype(observation.dtype), smooth)


class GlidePath(Policy):
    """Moves from one mix of assets and swaps to another, linearly in the funding ratio between two
    bounds. `logits` [2, n + b]: the mix at and below the lower bound, and the mix at and above the
    upper bound; `bounds` [2]: the bounds in units of `UNIT`. Before tuning, the mix is the same at
    all ratios.
    """

    limits: AllocationLimits
    logits: Array
    bounds: Array
    slot: int = eqx.field(static=True)

    def __init__(self, case: PensionCase, mix: ConstantMix, ratios: tuple[float, float]):
        self.limits, self.slot = mix.limits, _ratio_slot(case)
        self.logits = jnp.stack([mix.logits] * 2)
        self.bounds = jnp.asarray(ratios, jnp.float32) / UNIT

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        low, high = UNIT * self.bounds.astype(observation.dtype)
        width = jnp.maximum(high - low, 0.01)
        ratio = jnp.exp(RATIO * observation[self.slot])
        share = smooth.clip((ratio - low) / width, 0.0, 1.0, WIDTH / width)
        logits = self.logits.astype(observation.dtype)
        below, above = (self.limits(item, smooth) for item in (logits[0], logits[1]))
        return below + share * (above - below)


class LiabilityDriven(Policy):
    """A growth portfolio (classes with a separate shock) and a hedge (bonds, credit, cash).

    The growth share is growth[0] + growth[1] (F - 1), limited to 0 to 1; `growth` is in units of
    `UNIT`. `mix` [n] are the logits of the classes within the two portfolios, and `hedge` [b] those
    of the positions of the swaps in their ranges. If weights may be negative, the growth share is
    within `reach`, and the weight of a class within its portfolio is floor + (1 - sum of floors)
    softmax(mix); otherwise `floor` [n] is zero. Before tuning, it is a constant mix.
    """

    limits: AllocationLimits
    growth: Array
    mix: Array
    hedge: Array | None
    floor: Frozen
    reach: tuple[float, float] = eqx.field(static=True)
    has_shock: tuple[bool, ...] = eqx.field(static=True)
    slot: int = eqx.field(static=True)

    def __init__(self, case: PensionCase, mix: ConstantMix):
        count = len(case.assets.classes)
        self.limits, self.slot = mix.limits, _ratio_slot(case)
        self.has_shock = tuple(bool(i in case.assets.shocks) for i in range(count))
        held = np.asarray(_held(mix.limits, mix.logits[:count]))
        grown = held[np.array(self.has_shock)].sum()
        floor, self.reach = np.zeros(count), (0.0, 1.0)
        if case.assets.short:
            floor, self.reach = _floor(case, np.array(self.has_shock), float(grown))
        complete = _whole(np.array(self.has_shock), float(grown))
        self.floor = Frozen(floor)
        self.growth = jnp.asarray([grown / UNIT, 0.0], jnp.float32)
        self.mix = jnp.asarray(
            np.log(np.maximum(np.abs(held - floor * complete), MINIMUM)), jnp.float32
        )
        self.hedge = mix.logits[count:] if case.buckets else None

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        kind = observation.dtype
        local = np.array(self.has_shock)
        growth = UNIT * self.growth.astype(kind)
        ratio = jnp.exp(RATIO * observation[self.slot])
        share = smooth.clip(growth[0] + growth[1] * (ratio - 1), *self.reach, WIDTH)
        size = jnp.exp(self.mix.astype(kind) - jax.lax.stop_gradient(jnp.max(self.mix)))
        grown = jnp.where(local, size, 0.0)
        safe = jnp.where(local, 0.0, size)
        floor = jnp.asarray(self.floor.array, kind)
        above = 1 - jnp.sum(jnp.where(local, floor, 0.0)), 1 - jnp.sum(jnp.where(local, 0.0, floor))
        weights = share * above[0] * grown / jnp.maximum(jnp.sum(grown), 1e-9)
        weights = weights + (1 - share) * above[1] * safe / jnp.sum(safe)
        weights = weights + jnp.where(local, share, 1 - share) * floor
        return self.limits.action(self.limits.nearest(weights, smooth), self.hedge, smooth)


def _whole(local: np.ndarray, grown: float) -> np.ndarray:
    """[n] total weight of the portfolio of each class, kept away from zero."""
    complete = np.where(local, grown, 1 - grown)
    return np.where(np.abs(complete) < MINIMUM, MINIMUM, complete)


def _floor(case: PensionCase, local: np.ndarray, grown: float):
    """The smallest weights [n] of classes within their portfolios, and the range of the growth
    share."""
    low, high, complete = case.assets.low, case.assets.high, _whole(local, grown)
    # A portfolio that is borrowed as a whole turns bounds round.
    floor = np.minimum(np.minimum(low / complete, high / complete), 0.0)
    return floor, (min(0.0, float(low[local].sum())), max(1.0, float(high[local].sum())))


@compiled_sooner
def _held(limits: AllocationLimits, logits: Array) -> Array:
    return limits.weights(logits, Exact())


def followers(
    case: PensionCase, mix: ConstantMix, ratios: tuple[float, float]
) -> dict[str, tuple[str, Policy]]:
    """{key: (name, policy)} of the rules that follow the funding ratio, ready to be tuned.

    They start at a `mix` that was tuned before; the bounds of the glide path start at `ratios`.
    There are none if the funding ratio is not among the observations.
    """
    if not {"funding_ratio", "relative_funding"} & set(case.observation):
        return {}
    return {
        "glide_path": ("Glide path", GlidePath(case, mix, ratios)),
        "liability_driven": ("Liability-driven split", LiabilityDriven(case, mix)),
    }


def _ratio_slot(case: PensionCase) -> int:
    """The position of the logarithm of the funding ratio in the observation, or of the relative
    one."""
    observed: dict[str, slice] = slots(case)
    name = "funding_ratio" if "funding_ratio" in observed else "relative_funding"
    return observed[name].start


class PresentMix(Policy):
    """Today's weights, and today's notionals as positions in the ranges of the swaps.

    `mix` [n + b]. `every` is the number of steps from one rebalancing to the next; between them
    weights drift with the markets, and swaps keep their positions.
    """

    mix: Frozen
    every: Frozen
    time: int = eqx.field(static=True)
    held: slice = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def __init__(self, case: PensionCase, every: int):
        assets, overlay = case.assets, case.overlay
        observed = slots(case)
        parts = [assets.weight.used()]
        if overlay is not None:
            unit, width = limit_unit(case), overlay.high - overlay.low
            share = overlay.notional.used() / np.where(unit > 0, unit, 1.0)
            position = np.where(
                width > 0, (share - overlay.low) / np.where(width > 0, width, 1), 0.5
            )
            parts.append(np.clip(position, 0.0, 1.0))
        self.mix = Frozen(np.concatenate(parts))
        self.every = Frozen(np.array(float(every)))
        self.time = observed["time"].start if "time" in observed else -1
        self.held = observed.get("weights", slice(0, 0))
        self.steps = case.steps

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        mix = jnp.asarray(self.mix.array, observation.dtype)
        count = self.held.stop - self.held.start
        if self.time < 0 or not count:
            return mix
        every = jnp.asarray(self.every.array, observation.dtype)
        step = (1 + observation[self.time]) / 2 * self.steps
        # Half a step of room: the share of the horizon is not exact.
        since = step - every * jnp.floor((step + 0.5) / every)
        held = jnp.concatenate([observation[self.held], mix[count:]])
        return jnp.where(since < 0.5, mix, held)


def present_mixes(case: PensionCase) -> dict[str, tuple[str, Policy]]:
    """{key: (name, policy)} of the present mix: rebalanced at every step; and rebalanced yearly, if
    steps are shorter and the policy observes time and weights."""
    item = round(1 / case.step)
    table: dict[str, tuple[str, Policy]] = {
        "present_mix": ("Present mix", PresentMix(case, 1)),
    }
    if item > 1 and set(NEEDED) <= set(case.observation):
        table["present_mix_yearly"] = ("Present mix, rebalanced yearly", PresentMix(case, item))
    return table


class OneOf(Policy):
    """Decides like the rule at `position`; only this rule is tuned. All rules are evaluated, which
    is cheap compared with a step of the fund. In the compiled program the position is an argument,
    not a constant.
    """

    rules: tuple[Policy, ...]
    slot: Frozen

    def __init__(self, rules: Sequence[Policy], position: int):
        self.rules, self.slot = tuple(rules), Frozen(np.array(float(position)))

    @property
    def rule(self) -> Policy:
        """The rule that decides."""
        return self.rules[round(float(self.slot.array))]

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)
        position = jax.lax.stop_gradient(jnp.asarray(self.slot.array, observation.dtype))
        actions = [rule(observation, smooth) for rule in self.rules]
        action = actions[0]
        for i, item in enumerate(actions[1:], 1):
            action = jnp.where(jnp.abs(position - i) < 0.5, item, action)
        return action
