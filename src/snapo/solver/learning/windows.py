"""Training on windows of the horizon: short adjoints, and a critic for the time after it.

Through hundreds of steps of an unstable system an adjoint grows without limit. A window limits this
growth, but by itself it is short-sighted: its last decisions ignore their consequences. So every
window but the last ends with the value of its final state,

    E[ outputs of the window + critic(observation at its end, share of the horizon left) ],

where the critic is a network that learns by regression the value of all later outputs under the
present policy, from the sweep over the whole horizon that gives the windows their initial states.
Only an objective that is a mean of sums has such a value; others are refused.

The critic is a network that gives the value of all outputs that come after a state.

It is fitted by least squares to complete paths of the present policy, so that it is correct on
average for any window; its derivative is the value of a change of the state.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PyTree

from snapo.engine import Adjoint, BoundEngine, Rollout, Window
from snapo.problem.code.version import of_rollout, read_context
from snapo.problem.noise import Draws
from snapo.problem.objective import Mean, Objective
from snapo.problem.policy import Network
from snapo.problem.problem import Problem
from snapo.problem.simulator import Around, Schedule, Simulator, at
from snapo.problem.smooth import Smooth

from ..adjoint import adjoint_of_finite_paths, flat_weights, float64

HIDDEN, RATE = (64, 64), 3e-3  # of the critic
FIRST_FITS, FITS, SAMPLE = 300, 4, 2048  # regression steps at the start and later; samples of each
_ADAM = optax.adam(RATE)


class Critic(eqx.Module):
    """The value of all outputs from here on, in the units of the objective."""

    network: Network
    shift: Float[Array, ""]
    scale: Float[Array, ""]

    @property
    def features(self) -> int:
        """The length of an observation."""
        return self.network.weights[0].shape[1] - 1

    def __call__(self, observed: Float[Array, " features"], left: Float[Array, ""]):
        return self.shift + self.scale * self.network(jnp.append(observed, left))[0]


class Learner(NamedTuple):
    """The critic and the state of its regression."""

    critic: Critic
    optimiser: PyTree


def has_worth_ahead(problem: Problem) -> bool:
    """Whether the objective is a mean of sums, so that a state has a continuation value."""
    objective, kinds = problem.objective, problem.simulator.totals()
    return objective.linear and all(kinds.get(n, "sum") == "sum" for n in objective.outputs)


def learner(problem: Problem, seed: int) -> Learner:
    """An untrained critic.

    **Raises:** `ValueError` if the objective is not a mean of sums, since only that has a
    continuation value.
    """
    if not has_worth_ahead(problem):
        objective = problem.objective
        raise ValueError(
            "Training: window needs an objective that is a mean of outputs summed over the path; "
            f"{type(objective).__name__} of {', '.join(objective.outputs)} "
            "has no continuation value."
        )
    return blank(problem.features, seed)


def blank(features: int, seed: int = 0) -> Learner:
    """A critic of observations with this number of features, with initial weights."""
    key = jax.random.fold_in(jax.random.key(seed), 1)  # the policy's weights have the key itself
    network = Network((features + 1, *HIDDEN, 1), key=key, activation=jnp.tanh)
    critic = Critic(network, jnp.zeros(()), jnp.zeros(()))
    return Learner(critic, _ADAM.init(eqx.filter(network, eqx.is_inexact_array)))


def continuation_value(objective: Objective, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """The value of all outputs from each step on, [T, N], and which paths [N] are finite."""
    totals = float64(rollout.totals)
    paths = next(iter(totals.values())).size
    value = np.zeros((len(jax.tree.leaves(rollout.record["state"])[0]), paths))
    for name, weight in flat_weights(objective, paths).items():
        # An output of only `terminal` comes after every step.
        earned = float64(rollout.record["outputs"]).get(name, np.zeros(()))
        with np.errstate(invalid="ignore"):  # a path that exploded is left out below
            before = np.cumsum(earned, axis=0) - earned if earned.ndim else earned
            value += paths * weight * (totals[name] - before)
    return value, np.asarray(np.isfinite(value).all(0))


def fitted_critic(
    problem: Problem, available: Learner, states, value, valid, firsts, length: int, step: int
) -> Learner:
    """The critic after some steps of regression on states at the ends of windows."""
    endpoints = np.unique(firsts[firsts + length < problem.simulator.horizon] + length)
    if not endpoints.size or not valid.any():
        return available
    target = value[endpoints][:, valid]
    critic = available.critic
    if not float(critic.scale):
        spread = max(float(target.std()), 1e-12)
        scale = (jnp.asarray(x, jnp.float32) for x in (target.mean(), spread))
        critic = Critic(critic.network, *scale)
    left = (problem.simulator.horizon - endpoints) / problem.simulator.horizon
    selected = jax.tree.map(lambda leaf: leaf[endpoints][:, valid], states)
    nows = jax.tree.map(lambda leaf: np.asarray(leaf)[endpoints], problem.schedule.steps)
    displayed = observations(problem.simulator, problem.schedule.constants, nows, selected)
    lefts = np.broadcast_to(left[:, None, None], (*target.shape, 1))
    x = np.concatenate([displayed, lefts], axis=2).reshape(target.size, -1)
    y = (target.reshape(-1) - float(critic.shift)) / float(critic.scale)
    rng = np.random.default_rng((step, 1))
    fits = FITS if step else FIRST_FITS
    rows = rng.integers(0, y.size, (fits, min(SAMPLE, y.size)))
    values = jnp.asarray(x[rows], jnp.float32), jnp.asarray(y[rows], jnp.float32)
    network, optimiser = _regress(critic.network, available.optimiser, *values)
    return Learner(Critic(network, critic.shift, critic.scale), optimiser)


def observations(simulator: Simulator, constants, nows, states) -> Array:
    """Observations [ends, paths, features]."""
    with read_context(of_rollout(simulator, None, Schedule(constants, nows))):
        return _observations(simulator, constants, nows, states)


@eqx.filter_jit
def _observations(simulator: Simulator, constants, nows, states) -> Array:

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


UPDATES = 8  # windows that one sweep over the horizon serves
AHEAD = "worth ahead"  # the output that a critic adds to a window


class Windowed(Around):
    """A simulator whose `terminal` is the critic's value of the state at a window's end."""

    def prepare(self, inputs):
        raise NotImplementedError("`_ending` makes its schedule from that of the simulator")

    def initial(self, constants, noise):
        return self.inner.initial(constants["own"], noise)

    def observe(self, constants, now, state):
        return self.inner.observe(constants["own"], now, state)

    def step(self, constants, now, state, action, noise, smooth):
        return self.inner.step(constants["own"], now, state, action, noise, smooth)

    def terminal(self, constants, state, smooth):
        observed = self.inner.observe(constants["own"], constants["end"], state)
        # What only the end of the horizon gives comes later: it is part of the critic's value.
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
    """A sweep over the whole horizon: the states of its paths, and the critic fitted to it."""

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
    """The initial states of all windows, [T, N] a leaf, and the critic fitted again."""
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

    The windows take turns, so that each call covers `length` steps only.
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
    """The next window: each window once per round, in an order shuffled by the number of the
    round."""
    turn, position = divmod(number, count)
    return int(np.random.default_rng(turn).permutation(count)[position])


def _ending(problem: Problem, critic: Critic, end: int) -> tuple[Simulator, Schedule]:
    """The simulator and the schedule of windows that end before step `end`."""
    schedule, horizon = problem.schedule, problem.simulator.horizon
    left = np.asarray((horizon - end) / horizon)
    now = at(schedule.steps, end)
    constants = {"own": schedule.constants, "critic": critic, "end": now, "left": left}
    return Windowed(problem.simulator), Schedule(constants, schedule.steps)  # pyright: ignore
