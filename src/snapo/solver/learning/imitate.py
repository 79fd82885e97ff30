"""A policy that does as a rule does: a warm start for `solve`."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.engine import EngineName, choose
from snapo.problem.actions import Box
from snapo.problem.inputs import Frozen
from snapo.problem.meant import takes_problem
from snapo.problem.objective import Mean
from snapo.problem.policy import MLP, Policy, without_memory
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, Simulator

from ..train import Training, initial_progress, train

DISTANCE = "distance"
SHORT = Training(steps=300, paths=128, validation_paths=512)


class Imitating(Around):
    """The rule moves the state; the policy is charged for the square of its distance."""

    rule: Frozen
    scale: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, simulator: Simulator, rule: Policy, scale: tuple[float, ...]):
        self.inner, self.rule, self.scale = simulator, Frozen(rule), scale

    def step(self, constants, now, state, action, noise, smooth):
        right = self.rule.array(self.inner.observe(constants, now, state), smooth)
        after, _ = self.inner.step(constants, now, state, right, noise, smooth)
        away = (action - jax.lax.stop_gradient(right)) / jnp.asarray(self.scale, action.dtype)
        return after, {DISTANCE: jnp.sum(away**2) / self.inner.horizon}

    def terminal(self, constants, state, smooth):
        return {}

    def totals(self):
        return {}

    def control_variates(self):
        return ()

    def slack(self, constants, now, state, outputs):
        return {}


class Imitation(NamedTuple):
    """A policy that imitates a rule.

    - `distance`: the root of the mean square by which its decisions differ from the rule's, a
      component's range being 1 where it has one.
    """

    policy: Policy
    distance: float


@takes_problem(objective=False)
def imitate(
    problem: Problem,
    rule: Policy,
    policy: Policy | None = None,
    *,
    training: Training | None = None,
    engine: EngineName = "auto",
) -> Imitation:
    """Trains a policy to decide as `rule` does, in the states that the rule itself meets.

        begun = snapo.imitate(problem, snapo.BaseStock(12.0))
        solution = snapo.solve(problem, policy=begun.policy)

    **Arguments:**

    - `rule`: a policy without a memory. `policy`: as in `solve`; it may have one.
    - `training`: by default 300 steps with 128 paths.
    """
    without_memory(rule, "imitate")
    training = training or SHORT
    rule = rule.for_problem(problem.interface, jax.random.key(training.seed))
    followed = Imitating(problem.simulator, rule, _ranges(problem))
    # The rule's outputs are gone, and with them limits on them: the next training has those.
    problem = replace(problem, simulator=followed, objective=-Mean(DISTANCE), constraints=())
    policy = (policy or MLP()).for_problem(problem.interface, jax.random.key(training.seed))
    engines = choose(engine, problem, policy)
    progress = train(problem, initial_progress(policy, training, problem), training, engines.train)
    return Imitation(progress.best, float(np.sqrt(max(0.0, -progress.best_value))))


def _ranges(problem: Problem) -> tuple[float, ...]:
    """The range of every component of a decision; 1 where it is not bounded."""
    action = problem.action
    if not isinstance(action, Box):
        return (1.0,) * action.size
    low, high = action.bounds()
    with np.errstate(invalid="ignore"):
        width = high - low
    return tuple(np.where(np.isfinite(width) & (width > 0), width, 1.0).tolist())
