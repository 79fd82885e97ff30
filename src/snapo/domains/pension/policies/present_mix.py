"""The mix of today, held: rebalanced to its weights at every step, or once a year."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snapo.problem.inputs import Frozen
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT

from ..fund.observation import slots
from ..fund.swap_limits import limit_unit
from ..records.case import PensionCase

NEEDED = ("time", "weights")  # of the observation, to see a year's end and what is held


class PresentMix(Policy):
    """Today's weights, and today's notionals as places in the ranges of the swaps.

    `mix` [n + b]. `every` is the number of steps from one rebalancing to the next; between them
    weights drift with the markets, and swaps stay at their places.
    """

    mix: Frozen
    every: Frozen
    time: int = eqx.field(static=True)
    held: slice = eqx.field(static=True)
    steps: int = eqx.field(static=True)

    def __init__(self, case: PensionCase, every: int):
        assets, overlay = case.assets, case.overlay
        seen = slots(case)
        parts = [assets.weight.used()]
        if overlay is not None:
            unit, width = limit_unit(case), overlay.high - overlay.low
            share = overlay.notional.used() / np.where(unit > 0, unit, 1.0)
            place = np.where(width > 0, (share - overlay.low) / np.where(width > 0, width, 1), 0.5)
            parts.append(np.clip(place, 0.0, 1.0))
        self.mix = Frozen(np.concatenate(parts))
        self.every = Frozen(np.array(float(every)))
        self.time = seen["time"].start if "time" in seen else -1
        self.held = seen.get("weights", slice(0, 0))
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
    """{key: (name, policy)}: rebalanced at every step, and yearly where steps are shorter and the
    policy sees time and weights."""
    each = round(1 / case.step)
    found: dict[str, tuple[str, Policy]] = {
        "present_mix": ("Present mix", PresentMix(case, 1)),
    }
    if each > 1 and set(NEEDED) <= set(case.observation):
        found["present_mix_yearly"] = ("Present mix, rebalanced yearly", PresentMix(case, each))
    return found
