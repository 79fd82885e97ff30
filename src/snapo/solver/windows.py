"""Training on windows of the horizon: short adjoints, and a critic for all that comes after.

Through hundreds of steps of an unstable system an adjoint grows without limit. A window cuts it,
and a window alone is short-sighted: nothing tells its last decisions of their consequences. So
every window but the last ends with the value of its final state,

    E[ outputs of the window + critic(observation at its end, share of the horizon left) ],

where the critic is a network that learns by regression the worth of all later outputs under the
present policy, from the sweep over the whole horizon that gives the windows their first states.
Only an objective that is a mean of sums has such a value; others are refused.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PyTree

from snapo.engine import Adjoint, Bound, Window
from snapo.problem.noise import Draws
from snapo.problem.objective import Mean, Objective
from snapo.problem.policy import Network
from snapo.problem.problem import Problem
from snapo.problem.simulator import Schedule, Simulator, at

from .adjoint import flat_weights, float64
from .finite_paths import adjoint_of_finite_paths

AHEAD = "worth ahead"  # the output that a critic adds to a window
HIDDEN, RATE = (64, 64), 3e-3  # of the critic
FIRST_FITS, FITS, SAMPLE = 300, 4, 2048  # regression steps at the start and later; samples of each


class Critic(eqx.Module):
    """The worth of all outputs from here on, in the units of the objective."""

    network: Network
    shift: Float[Array, ""]
    scale: Float[Array, ""]

    def __call__(self, seen: Float[Array, " features"], left: Float[Array, ""]):
        return self.shift + self.scale * self.network(jnp.append(seen, left))[0]


class Learner(NamedTuple):
    """The critic and the state of its regression."""

    critic: Critic
    optimiser: PyTree


class Windowed(Simulator):
    """A simulator whose `terminal` is the critic's value of the state at a window's end."""

    own: Simulator

    def __init__(self, own: Simulator):
        self.own = own

    @property
    def horizon(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.horizon

    @property
    def action(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.action

    @property
    def noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.noise_size

    @property
    def initial_noise_size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.own.initial_noise_size

    def prepare(self, inputs):
        raise NotImplementedError("its schedule is made of the simulator's own, by `_ending`")

    def initial(self, constants, noise):
        return self.own.initial(constants["own"], noise)

    def observe(self, constants, now, state):
        return self.own.observe(constants["own"], now, state)

    def step(self, constants, now, state, action, noise, smooth):
        return self.own.step(constants["own"], now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        seen = self.own.observe(constants["own"], constants["end"], state)
        return {AHEAD: constants["critic"](seen, constants["left"])}

    def totals(self):
        return self.own.totals()

    def state_scale(self, constants):
        return self.own.state_scale(constants["own"])


def learner(problem: Problem, seed: int) -> Learner:
    """A critic that knows nothing yet.

    **Raises:** `ValueError` where the objective is no mean of sums, which alone has a worth ahead.
    """
    objective, kinds = problem.objective, problem.simulator.totals()
    if not objective.linear or any(kinds.get(name, "sum") != "sum" for name in objective.outputs):
        raise ValueError(
            "Training: window needs an objective that is a mean of outputs summed over the path; "
            f"{type(objective).__name__} of {', '.join(objective.outputs)} has no worth ahead."
        )
    key = jax.random.fold_in(jax.random.key(seed), 1)  # the policy's weights have the key itself
    network = Network((problem.features + 1, *HIDDEN, 1), key=key, activation=jnp.tanh)
    critic = Critic(network, jnp.zeros(()), jnp.zeros(()))
    return Learner(critic, _ADAM.init(eqx.filter(network, eqx.is_inexact_array)))


def starts(horizon: int, length: int) -> np.ndarray:
    """The first steps of all windows: half a window apart, and one that reaches the end."""
    return np.unique(
        np.append(np.arange(0, horizon - length, max(1, length // 2)), horizon - length)
    )


def window_adjoint(
    problem: Problem,
    bound: Bound,
    known: Learner,
    policy: PyTree,
    draws: Draws,
    smooth: Any,
    length: int,
    step: int,
    **options,
) -> tuple[float, Adjoint, int, Learner]:
    """One window's objective and adjoint, the number of bad paths, and the critic, fitted anew.

    The windows take turns, so that each call goes back through `length` steps only.
    """
    horizon = problem.simulator.horizon
    firsts = starts(horizon, length)
    rolled = bound.values(policy, draws, smooth, record=("state", "outputs"))
    worth, good = _worth_ahead(problem.objective, rolled)
    known = _fitted(problem, known, rolled.record["state"], worth, good, firsts, length, step)
    first = int(firsts[_turn(step, firsts.size)])
    options["start"] = jax.tree.map(lambda leaf: leaf[first], rolled.record["state"])
    if first + length == horizon:
        options["window"], objective = Window(first, length), problem.objective
    else:
        bound = Bound(bound.engine, *_ending(problem, known.critic, first + length))
        options["window"] = Window(first, length, terminal=True)
        objective = problem.objective + Mean(AHEAD)
    value, result, bad = adjoint_of_finite_paths(bound, policy, draws, smooth, objective, **options)
    return value, result, bad, known


def _turn(step: int, count: int) -> int:
    """Which window is next: each once a round, in an order that a round's number shuffles."""
    turn, place = divmod(step, count)
    return int(np.random.default_rng(turn).permutation(count)[place])


def _ending(problem: Problem, critic: Critic, end: int) -> tuple[Simulator, Schedule]:
    """The simulator and the schedule of windows that end before step `end`."""
    schedule, horizon = problem.schedule, problem.simulator.horizon
    left = np.asarray((horizon - end) / horizon)
    now = at(schedule.steps, end)
    constants = {"own": schedule.constants, "critic": critic, "end": now, "left": left}
    return Windowed(problem.simulator), Schedule(constants, schedule.steps)


def _worth_ahead(objective: Objective, rolled) -> tuple[np.ndarray, np.ndarray]:
    """The worth of all outputs from each step on, [T, N], and which paths [N] are finite."""
    totals = float64(rolled.totals)
    paths = next(iter(totals.values())).size
    worth = np.zeros(())
    for name, weight in flat_weights(objective, paths).items():
        earned = rolled.record["outputs"].get(name)
        # An output of `terminal` alone lies ahead of every step.
        past = 0.0 if earned is None else np.cumsum(np.asarray(earned, np.float64), axis=0)
        before = 0.0 if earned is None else past - np.asarray(earned, np.float64)
        worth = worth + paths * weight * (totals[name] - before)
    worth = np.broadcast_to(worth, (len(_lead(rolled.record["state"])), paths))
    return worth, np.asarray(np.isfinite(worth).all(0))


def _lead(tree: PyTree):
    return jax.tree.leaves(tree)[0]


_ADAM = optax.adam(RATE)


def _fitted(
    problem: Problem, known: Learner, states, worth, good, firsts, length: int, step: int
) -> Learner:
    """The critic after some steps of regression on states at the ends of windows."""
    ends = np.unique(firsts[firsts + length < problem.simulator.horizon] + length)
    if not ends.size or not good.any():
        return known
    target = worth[ends][:, good]
    critic = known.critic
    if not float(critic.scale):
        spread = max(float(target.std()), 1e-12)
        scale = (jnp.asarray(x, jnp.float32) for x in (target.mean(), spread))
        critic = Critic(critic.network, *scale)
    left = (problem.simulator.horizon - ends) / problem.simulator.horizon
    chosen = jax.tree.map(lambda leaf: leaf[ends][:, good], states)
    nows = jax.tree.map(lambda leaf: np.asarray(leaf)[ends], problem.schedule.steps)
    seen = _seen(problem.simulator, problem.schedule.constants, nows, chosen)
    lefts = np.broadcast_to(left[:, None, None], (*target.shape, 1))
    x = np.concatenate([seen, lefts], axis=2).reshape(target.size, -1)
    y = (target.reshape(-1) - float(critic.shift)) / float(critic.scale)
    rng = np.random.default_rng((step, 1))
    fits = FITS if step else FIRST_FITS
    rows = rng.integers(0, y.size, (fits, min(SAMPLE, y.size)))
    given = jnp.asarray(x[rows], jnp.float32), jnp.asarray(y[rows], jnp.float32)
    network, optimiser = _regress(critic.network, known.optimiser, *given)
    return Learner(Critic(network, critic.shift, critic.scale), optimiser)


@eqx.filter_jit
def _seen(simulator: Simulator, constants, nows, states) -> Array:
    """Observations [ends, paths, features]."""

    def one(now, state):
        return simulator.observe(constants, now, state)

    return jax.vmap(jax.vmap(one, (None, 0)))(nows, states)


@eqx.filter_jit
def _regress(network: Network, state, x: Float[Array, "K n f"], y: Float[Array, "K n"]):
    """K steps of least squares."""

    def error(network, x, y):
        return jnp.mean((jax.vmap(network)(x)[:, 0] - y) ** 2)

    moving, fixed = eqx.partition(network, eqx.is_inexact_array)

    def fit(carry, sample):
        moving, state = carry
        slope = jax.grad(lambda moving: error(eqx.combine(moving, fixed), *sample))(moving)
        change, state = _ADAM.update(slope, state, moving)
        return (eqx.apply_updates(moving, change), state), None

    (moving, state), _ = jax.lax.scan(fit, (moving, state), (x, y))
    return eqx.combine(moving, fixed), state
