"""Training on windows of the horizon: short adjoints, and a critic for all that comes after.

Through hundreds of steps of an unstable system an adjoint grows without limit. A window cuts it,
and a window alone is short-sighted: nothing tells its last decisions of their consequences. So
every window but the last ends with the value of its final state,

    E[ outputs of the window + critic(observation at its end, share of the horizon left) ],

where the critic is a network that learns by regression the worth of all later outputs under the
present policy, from the sweep over the whole horizon that gives the windows their first states.
Only an objective that is a mean of sums has such a value; others are refused.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from snapo.engine import Adjoint, BoundEngine, Window
from snapo.problem.noise import Draws
from snapo.problem.objective import Mean
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, Schedule, Simulator, at
from snapo.problem.smooth import Smooth

from ..adjoint import float64
from ..finite_paths import adjoint_of_finite_paths
from .critic import Critic, Learner, continuation_value, fitted_critic

UPDATES = 8  # windows that one sweep over the horizon serves
AHEAD = "worth ahead"  # the output that a critic adds to a window


class Windowed(Around):
    """A simulator whose `terminal` is the critic's value of the state at a window's end."""

    def prepare(self, inputs):
        raise NotImplementedError("its schedule is made of the simulator's own, by `_ending`")

    def initial(self, constants, noise):
        return self.inner.initial(constants["own"], noise)

    def observe(self, constants, now, state):
        return self.inner.observe(constants["own"], now, state)

    def step(self, constants, now, state, action, noise, smooth):
        return self.inner.step(constants["own"], now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        observed = self.inner.observe(constants["own"], constants["end"], state)
        # What the horizon's end alone gives lies ahead: it is part of the critic's worth.
        later = dict.fromkeys(self.inner.terminal(constants["own"], state, smooth), jnp.zeros(()))
        return later | {AHEAD: constants["critic"](observed, constants["left"])}

    def state_scale(self, constants):
        return self.inner.state_scale(constants["own"])

    def slack(self, constants, now, state, outputs):
        return self.inner.slack(constants["own"], now, state, outputs)


def starts(horizon: int, length: int) -> np.ndarray:
    """The first steps of all windows: half a window apart, and one that reaches the end."""
    return np.unique(
        np.append(np.arange(0, horizon - length, max(1, length // 2)), horizon - length)
    )


class Sweep(NamedTuple):
    """A sweep over the whole horizon: the states of its paths, and the critic that it taught."""

    objective: float
    states: PyTree
    critic: Learner


def sweep(
    problem: Problem,
    bound_engine: BoundEngine,
    learner: Learner,
    policy: PyTree,
    draws: Draws,
    smooth: Smooth,
    length: int,
    step: int,
) -> Sweep:
    """The first states of all windows, [T, N] a leaf, and the critic fitted anew."""
    rollout = bound_engine.values(policy, draws, smooth, record=("state", "outputs"))
    value, valid = continuation_value(problem.objective, rollout)
    states, firsts = rollout.record["state"], starts(problem.simulator.horizon, length)
    learner = fitted_critic(problem, learner, states, value, valid, firsts, length, step)
    totals = {name: total[valid] for name, total in float64(rollout.totals).items()}
    objective = problem.objective.value(totals) if valid.any() else float("nan")
    return Sweep(objective, states, learner)


def window_adjoint(
    problem: Problem,
    bound_engine: BoundEngine,
    swept: Sweep,
    policy: PyTree,
    draws: Draws,
    smooth: Smooth,
    length: int,
    turn: int,
    **options,
) -> tuple[float, Adjoint, int]:
    """One window's objective and adjoint, and the number of bad paths.

    The windows take turns, so that each call goes back through `length` steps only.
    """
    horizon = problem.simulator.horizon
    firsts = starts(horizon, length)
    first = int(firsts[_turn(turn, firsts.size)])
    options["start"] = jax.tree.map(lambda leaf: leaf[first], swept.states)
    if first + length == horizon:
        options["window"], objective = Window(first, length), problem.objective
    else:
        bound_engine = BoundEngine(
            bound_engine.engine, *_ending(problem, swept.critic.critic, first + length)
        )
        options["window"] = Window(first, length, terminal=True)
        objective = problem.objective + Mean(AHEAD)
    return adjoint_of_finite_paths(bound_engine, policy, draws, smooth, objective, **options)


def _turn(number: int, count: int) -> int:
    """Which window is next: each once a round, in an order that a round's number shuffles."""
    turn, position = divmod(number, count)
    return int(np.random.default_rng(turn).permutation(count)[position])


def _ending(problem: Problem, critic: Critic, end: int) -> tuple[Simulator, Schedule]:
    """The simulator and the schedule of windows that end before step `end`."""
    schedule, horizon = problem.schedule, problem.simulator.horizon
    left = np.asarray((horizon - end) / horizon)
    now = at(schedule.steps, end)
    constants = {"own": schedule.constants, "critic": critic, "end": now, "left": left}
    return Windowed(problem.simulator), Schedule(constants, schedule.steps)  # pyright: ignore
