"""One of several options."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr
from jaxtyping import Array, Float

from ..smooth import Exact
from .base import ROUNDING, Actions, count

MINIMUM = 1e-6  # a probability whose logarithm is still taken
LARGEST = 0.12  # share of the scale that the root mean square of scores stays below


class Choice(Actions):
    """One of `size` options without an order: the action is a weight on each, and they sum to 1.

    In the value the weight is 1 on the option with the largest score. In training there are two
    ways to read the weights:

    - as a mixture, `action @ options`: right where the step is linear in the weights (a cost or a
      speed of each option), and otherwise a smoothing of it;
    - as probabilities, with `draw`: the step sees one option, as in the value, and derivatives
      are right whatever it does with it.

    `scale`: scores count in units of temperature times `scale`.

    Scores are counted from their mean, and their root mean square is kept below a level: at the
    usual temperature of the first steps an option keeps a part of the weight, however long all
    steps have said "not this one". Without, the slope of its weight would vanish with it, and a
    state in which it is the best one could not bring it back.

    >>> snapo.Choice(3).squash(np.float32([0.1, 0.7, 0.2]), snapo.Exact()).tolist()
    [0.0, 1.0, 0.0]
    """

    size: int = eqx.field(static=True)
    scale: float = eqx.field(static=True)

    def __init__(self, size: int, scale: float = 50.0):
        self.size, self.scale = count("Choice: size", size, 2, ", the number of options"), scale

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """softmax(kept(raw) / (temperature * scale)); exact: 1 on the largest score."""
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
        """(option, likelihood): one option at random, with probabilities `action`.

        `normal` is one of the step's standard normals. `option` [size] is 1 on the option drawn
        and carries no derivative. `likelihood` is the number 1; its derivative is that of the
        option's log probability. The simulator carries the product of all likelihoods, and
        multiplies by it every output that comes at or after the choice:

            option, likelihood = self.action.draw(action, noise[1])
            weight = state["weight"] * likelihood
            … {"cash": weight * cash}

        Then the derivative of the mean is right whatever an option does, jumps included (the
        likelihood ratio of Glynn, 1990). Its noise grows with the size of the output: take a
        guess off before, `guess + weight * (cash - guess)`, that does not depend on the choice.
        """
        uniform, upper = ndtr(normal), jnp.cumsum(jax.lax.stop_gradient(action))
        # The last option takes what rounding leaves over.
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
            "An exact Choice takes a weight of 1 on one option and 0 on the others: "
            "smooth.weights(…) or action.squash(…, smooth).",
        )

    def together(self) -> list[list[int]]:
        return [list(range(self.size))]
