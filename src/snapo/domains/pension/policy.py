"""The network of a pension fund: its weights lie within bounds and groups by construction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...inputs import Frozen
from ...policy import Network, Policy
from ...simulator import Schedule, Simulator, probe
from .records import PensionCase

MARGIN = 0.02  # of a range: a start nearer to a bound than this is moved inside, where it can learn


class Limits(Policy):
    """Turns real numbers, one per class and swap bucket, into an action within all limits.

    Weights are `smooth.simplex` of the first n numbers, places of the notionals in their ranges a
    logistic curve of the rest.
    """

    low: Frozen
    high: Frozen
    groups: tuple = eqx.field(static=True)

    def __init__(self, case: PensionCase):
        assets = case.assets
        self.low, self.high = Frozen(assets.low), Frozen(assets.high)
        self.groups = tuple((each.members, each.low, each.high) for each in assets.groups)

    def weights(self, logits: Array, smooth) -> Float[Array, " n"]:
        """Weights within bounds and groups."""
        low, high = (jnp.asarray(each.array, logits.dtype) for each in (self.low, self.high))
        return smooth.simplex(logits, low, high, self.groups)

    def nearest(self, weights: Array, smooth) -> Float[Array, " n"]:
        """Weights within the limits from weights that may leave them: these, where they do not."""
        low, high = (jnp.asarray(each.array, weights.dtype) for each in (self.low, self.high))
        width = high - low
        place = (weights - low) / jnp.where(width > 0, width, 1.0)
        return self.weights(_logit(jnp.clip(place, 1e-4, 1 - 1e-4)), smooth)

    def __call__(self, observation, smooth):
        count = self.low.array.shape[0]
        weights = self.weights(observation[:count], smooth)
        return with_swaps(weights, observation[count:])


class PensionPolicy(Policy):
    """A network around what the fund holds now.

    **Arguments:**

    - `features`: size of the observation; `hidden`: widths of the layers between.
    """

    network: Network
    limits: Limits
    start: Frozen

    def __init__(self, case: PensionCase, features: int, *, key, hidden: tuple[int, ...]):
        start = present(case)
        widths = (features, *hidden, len(start))
        self.network = Network(widths, key=key, activation=jax.nn.tanh)
        self.limits, self.start = Limits(case), Frozen(start)

    def __call__(self, observation, smooth):
        start = jnp.asarray(self.start.array, observation.dtype)
        return self.limits(start + self.network(observation), smooth)


def new_policy(case: PensionCase, simulator: Simulator, schedule: Schedule, key) -> PensionPolicy:
    """The network of a case, untrained: it keeps about what the fund holds now."""
    features = probe(simulator, schedule)[1].shape[0]
    return PensionPolicy(case, features, key=key, hidden=case.hidden)


def with_swaps(weights: Array, logits: Array | None) -> Array:
    """The action of these weights and of the places of the notionals in their ranges, if any."""
    if logits is None or not logits.size:
        return weights
    return jnp.concatenate([weights, jax.nn.sigmoid(logits.astype(weights.dtype))])


def present(case: PensionCase) -> np.ndarray:
    """[n + b] the numbers from which `Limits` makes about the present weights and notionals."""
    assets, overlay = case.assets, case.overlay
    place = [_place(assets.weight.used(), assets.low, assets.high)]
    if overlay is not None:
        share = overlay.notional.used() / float(assets.amount.used())
        place.append(_place(share, overlay.low, overlay.high))
    inside = np.clip(np.concatenate(place), MARGIN, 1 - MARGIN)
    return np.log(inside / (1 - inside)).astype(np.float32)


def _place(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.where(high > low, (values - low) / np.where(high > low, high - low, 1.0), 0.5)


def _logit(x: Array) -> Array:
    return jnp.log(x / (1 - x))
