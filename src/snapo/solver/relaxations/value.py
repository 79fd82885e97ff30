"""An approximate value of a stopping problem, by regression on simulated paths.

Backwards in time, the value of waiting is fitted to the value a step later (Longstaff and
Schwartz 2001; Tsitsiklis and Van Roy 2001), and the value is the better one of stopping and
waiting. It is used only for penalties: its error widens a bound, and never makes it wrong.

It needs the earnings of every decision of a stopping problem, on states that decisions do not move.

A state is split in two: the weights of `Stop` (the rights left), and all else, which no decision
may affect. Then the states of one path are valid for every stopping rule: a step's earnings are
computed for every number of rights left, with and without using one.
"""

from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from snapo.engine import Xla
from snapo.problem.actions import Stop
from snapo.problem.code.version import followed
from snapo.problem.problem import Problem
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from ..learning.features import affected_by_decisions

PATHS = 16  # on which the rights are compared with those at the start, if none is used


class NotStopping(ValueError):
    """A problem without a bound as a stopping problem; the message has the reason."""


class Decisions(NamedTuple):
    """A stopping problem: its parts, and the position of the rights in the state.

    - `rights`: the number of rights; `right`: the position of their leaf in the flattened state.
    - `values`: {output: its weight in the objective}.
    """

    problem: Problem
    rights: int
    right: int
    values: dict[str, float]

    def step(self, schedule, t: Array, state: PyTree, noise: Array) -> tuple[PyTree, Array]:
        """One path: the next state, and the earnings [rights + 1, 2] with 0, 1, … rights left,
        of waiting and of using one. The rights in both states are ignored."""
        simulator, now = self.problem.simulator, at(schedule.steps, t)

        def decided(left, use):
            action = jnp.full(self.rights, use, noise.dtype)
            values = self.having(state, left)
            return simulator.step(schedule.constants, now, values, action, noise, Exact())

        def earned(left, use):
            return self.earned(decided(left, use)[1])

        both = jax.vmap(jax.vmap(earned, (None, 0)), (0, None))
        earnings = both(jnp.arange(self.rights + 1), jnp.arange(2.0))
        return decided(self.rights, 0.0)[0], earnings

    def end(self, schedule, state: PyTree) -> Array:
        """One path: the earnings of its terminal state [rights + 1], by the rights left."""
        terminal, constants = self.problem.simulator.terminal, schedule.constants

        def earned(left):
            return self.earned(terminal(constants, self.having(state, left), Exact()))

        return jax.vmap(earned)(jnp.arange(self.rights + 1))

    def observe(self, schedule, t: Array, state: PyTree) -> Array:
        """One path: the policy's observation with all rights left."""
        simulator, now = self.problem.simulator, at(schedule.steps, t)
        return simulator.observe(schedule.constants, now, self.having(state, self.rights))

    def having(self, state: PyTree, left: Any) -> PyTree:
        """A state with this number of rights left."""
        leaves, tree = jax.tree.flatten(state)
        weights = (jnp.arange(1, self.rights + 1) == left).astype(leaves[self.right].dtype)
        leaves[self.right] = weights
        return jax.tree.unflatten(tree, leaves)

    def earned(self, outputs: dict[str, Array]) -> Array:
        """The contribution of outputs to the objective."""
        weights = [
            weight * outputs[name] for name, weight in self.values.items() if name in outputs
        ]
        return jnp.asarray(sum(weights), jnp.float64)

    def left(self, states: PyTree) -> np.ndarray:
        """[…] whole numbers: the rights left in states of any leading axes."""
        weights = np.asarray(jax.tree.leaves(states)[self.right])
        return np.rint(weights @ np.arange(1, self.rights + 1)).astype(int)


def decisions(problem: Problem) -> Decisions:
    """The problem as a stopping problem.

    **Raises:** `NotStopping` if it is not one, or has no bound: an action other than one `Stop`, an
    objective other than means of sums, or a decision that affects the state.
    """
    simulator, objective = problem.simulator, problem.objective
    if not isinstance(simulator.action, Stop):
        kind = type(simulator.action).__name__
        raise NotStopping(f"its action is a {kind}; only a `Stop` has a bound without a relaxation")
    totals = simulator.totals()
    if not objective.linear or any(totals.get(n, "sum") != "sum" for n in objective.outputs):
        raise NotStopping("its objective is not a mean of outputs that are summed over the path")
    right = _right(problem, simulator.action)
    one = {name: np.zeros(1) for name in objective.outputs}
    value = {name: float(weight[0]) for name, weight in objective.weights(one).items()}
    return Decisions(problem, simulator.action.rights, right, value)


def _right(problem: Problem, action: Stop) -> int:
    """The leaf of the state that holds the rights, the only one that decisions move."""
    source, simulator = problem.sources.evaluation, problem.simulator
    paths = np.arange(min(PATHS, source.available(PATHS)))
    draws, engine = source.draws(paths, simulator), Xla(precision="float64").bind(problem)
    waits = np.zeros((simulator.horizon, len(paths), action.size))
    rollout = engine.values(None, draws, Exact(), actions=waits, record=("state",))
    states, start = jax.tree.leaves(states_of(rollout)), np.asarray(action.initial())
    flags = jax.tree_util.tree_leaves_with_path(affected_by_decisions(problem))
    moved = [i for i, (_, flag) in enumerate(flags) if flag]
    for i in moved:
        if states[i].shape[2:] != (action.rights,) or np.any(states[i] != start):
            name = jax.tree_util.keystr(flags[i][0]) or "itself"
            raise NotStopping(f"its decisions may change the state {name}, not only rights")
    if len(moved) != 1:
        message = "more than one part of the state" if moved else "no state that `Stop.use` moves"
        raise NotStopping(f"it keeps the rights in {message}")
    return moved[0]


def states_of(rollout) -> PyTree:
    """The states of a rollout, leaves [T + 1, N, …]: those of every step and the last ones."""
    return jax.tree.map(
        lambda a, b: np.concatenate([np.asarray(a), np.asarray(b)[None]]),
        rollout.record["state"],
        rollout.state,
    )


MAXIMUM, DEGREE = 100, 6  # functions, and the degree of a polynomial
REACH = 4.0  # standard deviations
MINIMUM = 1e-9  # of a number's size: a smaller deviation is none


def exponents(numbers: int) -> list[tuple[int, ...]]:
    """The factors of every monomial, by degree: (), (0,), (1,), (0, 0), …; at most `MAXIMUM`."""
    results: list[tuple[int, ...]] = []
    for degree in range(DEGREE + 1):
        more = list(combinations_with_replacement(range(numbers), degree))
        if degree > 1 and len(results) + len(more) > MAXIMUM:
            break
        results += more
    return results


class Scale(NamedTuple):
    """The scale of the numbers [d] of one step: a scaled number is (number - centre) x per."""

    centre: Float[Array, " d"]
    per: Float[Array, " d"]

    @classmethod
    def of(cls, numbers: Float[np.ndarray, "paths d"]) -> "Scale":
        """The scale of a sample; a number that is the same on all paths counts as zero."""
        centre, deviation = numbers.mean(0), numbers.std(0)
        varies = deviation > MINIMUM * np.maximum(np.abs(centre), 1.0)
        per = np.where(varies, 1 / np.where(varies, deviation, 1.0), 0.0)
        return cls(jnp.asarray(centre), jnp.asarray(per))


def functions(numbers: Float[Array, " d"], scale: Scale) -> Float[Array, " functions"]:
    """The monomials of one path's numbers."""
    x = jnp.clip((numbers - scale.centre) * scale.per, -REACH, REACH)
    table: dict[tuple[int, ...], Array] = {(): jnp.ones((), x.dtype)}
    for factors in exponents(x.shape[0])[1:]:
        table[factors] = table[factors[:-1]] * x[factors[-1]]
    return jnp.stack(list(table.values()))


RIDGE = 1e-10  # of the normal equations, against their largest diagonal number


class Fitted(NamedTuple):
    """The value: `scales` of every step, leaves [T, d]; `waiting` [T, rights + 1, functions]."""

    scales: Scale
    waiting: Float[Array, "steps left functions"]


def value(
    decisions: Decisions, schedule, resolved: Fitted, t: Array, state: PyTree
) -> Float[Array, " left"]:
    """One path: the value at step t, by the rights left."""
    numbers, earnings = basis_and_earnings(decisions, schedule, t, state)
    result = at(resolved.waiting, t) @ functions(numbers, at(resolved.scales, t))
    return better(earnings, result)


def better(earnings: Float[Array, "left 2"], after: Float[Array, " left"]) -> Float[Array, " left"]:
    """The value of the better decision, from the continuation value."""
    waiting, using = earnings[:, 0] + after, earnings[1:, 1] + after[:-1]
    return jnp.concatenate([waiting[:1], jnp.maximum(waiting[1:], using)])


def basis_and_earnings(
    decisions: Decisions, schedule, t: Array, state: PyTree
) -> tuple[Array, Array]:
    """One path: the numbers of the basis, and every decision's earnings without noise."""
    calm = jnp.zeros(decisions.problem.simulator.noise_size)
    _, earnings = decisions.step(schedule, t, state, calm)
    gain = earnings[-1, 1] - earnings[-1, 0]
    return jnp.append(decisions.observe(schedule, t, state), gain), earnings


def fit(decisions: Decisions, source: Scenarios, paths: int, schedule) -> Fitted:
    """The value fitted on paths of a source; call it inside `jax.enable_x64(True)`."""
    problem = decisions.problem
    engine, simulator = Xla(precision="float64").bind(problem), problem.simulator
    draws = source.draws(np.arange(source.available(paths)), simulator)
    waits = np.zeros((simulator.horizon, draws.size, decisions.rights))
    states = states_of(engine.values(None, draws, Exact(), actions=waits, record=("state",)))
    item = jax.vmap(lambda t, state: basis_and_earnings(decisions, schedule, t, state), (None, 0))
    numbers_of = followed(jax.jit(item), problem.version)
    functions_of = jax.jit(jax.vmap(functions, (0, None)))
    better_of = jax.jit(jax.vmap(better))
    last = jax.vmap(lambda state: decisions.end(schedule, state))
    endpoints = followed(jax.jit(last), problem.version)
    ahead = np.asarray(endpoints(at(states, simulator.horizon)))
    scales, waiting = [], []
    for t in reversed(range(simulator.horizon)):
        numbers, earnings = numbers_of(jnp.asarray(t), at(states, t))
        scale = Scale.of(np.asarray(numbers))
        basis = np.asarray(functions_of(numbers, scale))
        normal = basis.T @ basis
        normal[np.diag_indices_from(normal)] += RIDGE * normal.diagonal().max()
        result = np.linalg.solve(normal, basis.T @ ahead).T
        ahead = np.asarray(better_of(earnings, basis @ result.T))
        scales.insert(0, scale)
        waiting.insert(0, result)
    centre, per = (jnp.stack(entry) for entry in zip(*scales))
    return Fitted(Scale(centre, per), jnp.stack(waiting))
