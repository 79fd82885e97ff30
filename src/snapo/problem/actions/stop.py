"""When to stop: a right, or several, to be used once each."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..smooth import Smooth
from .base import ROUNDING, Actions, count

NEAR = 1e-3  # a hazard nearer to 0 or 1 than this moves as if it were this


class Stop(Actions):
    """At every step: stop, or go on. With `rights` above 1: use one of the rights left, or wait.

    In the value an action is 1, stop, or 0, go on. In training it is a hazard: the probability of
    stopping here if not before. A path then is not stopped, it fades: the simulator's state holds
    the weight that is still alive, and pays the payoff on the part that stops. That is the
    expectation over the moment of stopping, without any jump, so that its derivative is right.
    (An indicator of "stop now" in its place trains to stopping at once.)

        def initial(…):   state = {…, "right": self.action.initial()}
        def step(…):      right, used = self.action.use(state["right"], action)
                          return {…, "right": right}, {"payoff": used * payoff}
        def terminal(…):  return {"payoff": self.action.alive(state["right"]) * payoff}

    Size: one hazard for each number of rights left, since how to decide depends on it.

    - `rights`: how often it can be used, at most once a step.
    - `hazard`: of an untrained network, 0 to 1. Small enough that paths get to later steps.
    - `scale`: scores count in units of temperature times `scale`.
    """

    rights: int = eqx.field(static=True)
    hazard: float = eqx.field(static=True)
    scale: float = eqx.field(static=True)

    def __init__(self, rights: int = 1, hazard: float = 0.005, scale: float = 50.0):
        if not 0 < hazard < 1:
            raise ValueError(f"Stop: hazard is {hazard}; allowed is above 0 and below 1.")
        self.rights, self.hazard, self.scale = count("Stop: rights", rights, 1), hazard, scale

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.rights

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """(1 + u / (1 + u^2)^.5) / 2 of the score u: raw, so moved that of 0 comes the untrained
        hazard, by temperature * scale; exact: 1 where it is above 0.

        Not the logistic curve: its slope vanishes like the hazard itself, so that a training whose
        first steps all say "stop less" never comes back.
        """
        return self._hazard(raw + _score(self.hazard), smooth)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """A hazard whose score is that of `base` plus a correction."""
        return self._hazard(_score(jnp.clip(base, NEAR, 1 - NEAR)) + correction, smooth)

    def _hazard(self, score: Array, smooth) -> Array:
        exact = smooth.indicator(score)
        if not isinstance(smooth, Smooth):
            return exact
        width = smooth.temperature * self.scale
        hot = width > 0
        u = jnp.where(hot, score, 0.0) / jnp.where(hot, width, 1.0)
        size = jnp.where(u < 0, -u, u)  # not abs, whose slope at 0 is 0
        root = jnp.sqrt(1 + u * u)
        # The smaller one of both probabilities: one less the larger would lose its digits.
        minimum = 0.5 / (root * (root + size))
        return jnp.where(hot, jnp.where(u < 0, minimum, 1 - minimum), exact)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return smooth.round(action)

    def initial(self) -> Float[Array, " rights"]:
        """The weights before the first step: 1 on "all rights left"."""
        return jnp.zeros(self.rights).at[-1].set(1.0)

    def use(self, right: Float[Array, " rights"], action: Float[Array, " size"]):
        """(right, used): the weights after this step's decision, and the expected rights used.

        `right` [rights] and `action` [rights] count from one right left to all of them.
        """
        moved = right * action
        used = moved.sum()
        arriving = jnp.concatenate([moved[1:], jnp.zeros_like(moved[:1])])
        return right - moved + arriving, used

    def left(self, right: Float[Array, " rights"]) -> Float[Array, ""]:
        """The expected number of rights left; for one right, the probability of being alive."""
        return jnp.arange(1, self.rights + 1, dtype=right.dtype) @ right

    def alive(self, right: Float[Array, " rights"]) -> Float[Array, ""]:
        """The probability that at least one right is left."""
        return right.sum()

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        if np.all(np.minimum(np.abs(action), np.abs(action - 1)) <= ROUNDING):
            return None
        return (
            f"It is {np.round(action, 4).tolist()}.",
            "An exact Stop is 1 or 0: smooth.indicator(…) or action.squash(…, smooth).",
        )


def _score(hazard):
    """The score of a hazard: the inverse of (1 + u / (1 + u^2)^.5) / 2."""
    return (hazard - 0.5) / (hazard * (1 - hazard)) ** 0.5
