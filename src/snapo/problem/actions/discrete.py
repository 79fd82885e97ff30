"""One of several options (`Choice`), and when to stop: one right or several, each of which can be
used once (`Stop`)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from ..smooth import Exact, Smooth
from .sets import ROUNDING, Actions, count

MINIMUM = 1e-6  # a probability whose logarithm is still taken
LARGEST = 0.12  # share of the scale that the root mean square of scores stays below


class Choice(Actions):
    """One of `size` unordered options: the action is a weight on each option, and the weights sum
    to 1.

    In the value the weight is 1 on the option with the largest score. In training there are two
    ways to read the weights:

    - as a mixture, `action @ options`: exact if the step is linear in the weights (a cost or a
      speed of each option), and otherwise a smooth approximation;
    - as probabilities, with `draw`: the step uses one option, as in the value, and derivatives are
      correct for any effect of the option.

    `scale`: scores count in units of temperature times `scale`.

    The mean of the scores is subtracted, and their root mean square is limited: at the usual
    temperature of the first steps every option keeps a part of the weight, even after many
    gradients against it. Otherwise the slope of an option's weight would vanish with the weight,
    and training could not restore it for states in which the option is the best one.

    >>> snapo.Choice(3).squash(np.float32([0.1, 0.7, 0.2]), snapo.Exact()).tolist()
    [0.0, 1.0, 0.0]
    """

    size: int = eqx.field(static=True)
    scale: float = eqx.field(static=True)

    def __init__(self, size: int, scale: float = 50.0):
        self.size, self.scale = count("Choice: size", size, 2, ", the number of options"), scale

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """softmax(kept / (temperature * scale)), where `kept` are the limited scores; in the exact
        set 1 on the largest score."""
        return smooth.weights(raw if isinstance(smooth, Exact) else self._kept(raw), self.scale)

    def _kept(self, raw: Float[Array, " size"]) -> Float[Array, " size"]:
        """Scores in the same order and proportion, below the level."""
        apart, maximum = raw - raw.mean(), LARGEST * self.scale
        return apart * (maximum / jnp.sqrt(maximum**2 + (apart**2).mean()))

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """Weights whose scores are the logarithms of `base` plus a correction."""
        return smooth.weights(jnp.log(jnp.maximum(base, MINIMUM)) + correction, self.scale)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return smooth.weights(action) if isinstance(smooth, Exact) else action

    def draw(self, action: Float[Array, " size"], normal: Array) -> tuple[Array, Array]:
        """The pair (option, likelihood): one option drawn at random, with the probabilities
        `action`.

        `normal` is one of the step's standard normals. `option` [size] is 1 on the option drawn and
        has no derivative. `likelihood` is the number 1; its derivative is that of the option's log
        probability. The simulator keeps the product of all likelihoods in its state, and multiplies
        every output at or after the choice by it:

            option, likelihood = self.action.draw(action, noise[1])
            weight = state["weight"] * likelihood
            … {"cash": weight * cash}

        Then the derivative of the mean is correct for any effect of an option, including jumps (the
        likelihood ratio of Glynn, 1990). The noise of this derivative grows with the size of the
        output: subtract a guess that does not depend on the choice, as in `guess + weight * (cash -
        guess)`.
        """
        uniform, upper = ndtr(normal), jnp.cumsum(jax.lax.stop_gradient(action))
        # The last option takes the remainder of the rounding.
        below = jnp.concatenate([uniform < upper[:-1], jnp.ones(1, bool)]).astype(action.dtype)
        option = below - jnp.concatenate([jnp.zeros(1, action.dtype), below[:-1]])
        probability = option @ action
        selected = jax.lax.stop_gradient(probability)
        likely = selected > 0
        return option, jnp.where(likely, probability, 1.0) / jnp.where(likely, selected, 1.0)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        if abs(action.max() - 1) <= ROUNDING and abs(np.abs(action).sum() - 1) <= 100 * ROUNDING:
            return None
        return (
            f"Its weights are {np.round(action, 4).tolist()}.",
            "An exact Choice takes a weight of 1 on one option and 0 on the others: use "
            "smooth.weights(…) or action.squash(…, smooth).",
        )

    def together(self) -> list[list[int]]:
        return [list(range(self.size))]


NEAR = 1e-3  # a hazard nearer to 0 or 1 than this moves as if it were this


class Stop(Actions):
    """At every step: stop or continue. With `rights` above 1: use one of the rights left, or wait.

    In the value an action is 1 (stop) or 0 (continue). In training it is a hazard: the probability
    of stopping at this step if no earlier step stopped. A path then does not stop at once: the
    simulator's state has the weight that has not stopped yet, and the payoff is paid on the part
    that stops. This is the expectation over the time of stopping, without any jump, so that its
    derivative is correct. (With an indicator of "stop now" instead, training converges to stopping
    at once.)

        def initial(…):   state = {…, "right": self.action.initial()}
        def step(…):      right, used = self.action.use(state["right"], action)
                          return {…, "right": right}, {"payoff": used * payoff}
        def terminal(…):  return {"payoff": self.action.alive(state["right"]) * payoff}

    The action has one hazard for each number of rights left, since the decision depends on it.

    - `rights`: how often the right can be used, at most once per step.
    - `hazard`: the hazard of an untrained network, between 0 and 1; it should be small enough for
      paths to reach later steps.
    - `scale`: scores count in units of temperature times `scale`.
    """

    rights: int = eqx.field(static=True)
    hazard: float = eqx.field(static=True)
    scale: float = eqx.field(static=True)

    def __init__(self, rights: int = 1, hazard: float = 0.005, scale: float = 50.0):
        if not 0 < hazard < 1:
            raise ValueError(f"Stop: hazard is {hazard}; it must be above 0 and below 1.")
        self.rights, self.hazard, self.scale = count("Stop: rights", rights, 1), hazard, scale

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.rights

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """(1 + u / (1 + u^2)^0.5) / 2, where u is the raw score, shifted by the score of the
        untrained hazard and divided by temperature * scale. In the exact set it is 1 if u is above
        0, else 0. The logistic curve is not used, because its slope vanishes like the hazard
        itself: training could then not recover if its first steps all lower the hazard.
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
        # The smaller one of both probabilities: one minus the larger would lose its digits.
        minimum = 0.5 / (root * (root + size))
        return jnp.where(hot, jnp.where(u < 0, minimum, 1 - minimum), exact)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return smooth.round(action)

    def initial(self) -> Float[Array, " rights"]:
        """The weights before the first step: 1 on "all rights left"."""
        return jnp.zeros(self.rights).at[-1].set(1.0)

    def use(self, right: Float[Array, " rights"], action: Float[Array, " size"]):
        """The pair (right, used): the weights after this step's decision, and the expected number
        of rights used. `right` [rights] and `action` [rights] have one entry for each number of
        rights left: for one right, for two … up to all.
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
            "An exact Stop is 1 or 0: use smooth.indicator(…) or action.squash(…, smooth).",
        )


def _score(hazard):
    """The score of a hazard: the inverse of (1 + u / (1 + u^2)^.5) / 2."""
    return (hazard - 0.5) / (hazard * (1 - hazard)) ** 0.5
