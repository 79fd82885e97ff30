"""Classical rules to compare with a trained policy: no action, a proportional controller, a linear
regulator."""

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.problem.inputs import Frozen, plain
from snapo.problem.policies.rules import Constant
from snapo.problem.policy import Policy, as_observation
from snapo.problem.smooth import EXACT

from .kinds import PlantValues
from .plants.plant import Plant
from .regulator import linearised, riccati


class LinearFeedback(Policy):
    """u = rest - K (state - target), clipped to the plant's limits.

    - `gains`: [T, m, n] one matrix for every step if the observation shows the remaining time, or
      else [1, m, n]. The states are a vector in the order of their names.
    - `numbers`: the numbers of the plant; `target` [n]; `rest`, `unit` [m]: u = rest + unit x
      action.
    """

    plant: Plant
    numbers: Frozen
    gains: Frozen
    target: Frozen
    middle: Frozen
    unit: Frozen
    rest: Frozen
    clipped: bool = eqx.field(static=True)

    def __init__(self, plant: Plant, p: PlantValues, gains: np.ndarray):
        zero, one = np.zeros(plant.action.size), np.ones(plant.action.size)
        middle = np.asarray(plant.drive(p, zero), np.float64)
        target = jax.flatten_util.ravel_pytree(plant.target_at(p))[0]
        self.plant, self.numbers, self.gains = plant, Frozen(dict(p)), Frozen(gains)
        self.target, self.rest = Frozen(np.asarray(target)), Frozen(plant.rest(p))
        self.middle, self.unit = Frozen(middle), Frozen(np.asarray(plant.drive(p, one)) - middle)
        self.clipped = bool(np.all(np.isfinite(plant.action.bounds())))

    def __call__(self, observation, smooth=EXACT):
        observation = as_observation(observation)

        def number(held: Frozen) -> Array:
            return jnp.asarray(held.array, observation.dtype)

        p = jax.tree.map(lambda x: jnp.asarray(x, observation.dtype), self.numbers.array)
        state = self.plant.recover(p, observation)
        away = jnp.concatenate([jnp.ravel(state[name]) for name in sorted(state)])
        gains, steps = number(self.gains), self.gains.array.shape[0]
        at = 0
        if steps > 1:
            at = jnp.clip(jnp.round((1 - observation[-1]) * steps).astype(int), 0, steps - 1)
        u = number(self.rest) - gains[at] @ (away - number(self.target))
        action = (u - number(self.middle)) / number(self.unit)
        return jnp.clip(action, -1.0, 1.0) if self.clipped else action


def classical_rules(plant: Plant, inputs) -> dict[str, Policy]:
    """{name: rule} of all classical rules that the plant has."""
    values = plain(inputs)
    p, w = values["plant"], values["cost"]
    policies: dict[str, Policy] = dict(plant.hand_rules(p))
    if not plant.rests:
        return {"no action": Constant(np.zeros(plant.action.size, np.float32)), **policies}
    size = sum(plant.sizes.values())
    policies["no action"] = LinearFeedback(plant, p, np.zeros((1, plant.action.size, size)))
    if gains := plant.proportional(p):
        nothing = {name: np.zeros((plant.action.size, n)) for name, n in plant.sizes.items()}
        item = {name: gains[name][:, None] if name in gains else nothing[name] for name in nothing}
        rows = np.concatenate([item[name] for name in sorted(item)], axis=1)
        policies["proportional"] = LinearFeedback(plant, p, rows[None])
    policies["linear regulator"] = LinearFeedback(plant, p, regulator(plant, p, w))
    return policies


def regulator(plant: Plant, p: PlantValues, w: PlantValues) -> np.ndarray:
    """The Riccati gains around the target: a matrix for every step, or only the first if the policy
    does not observe time."""
    gains = riccati(linearised(plant, p, w), plant.horizon).K
    return gains if plant.time_feature else gains[:1]
