"""Partial observation: numbers of the state that matter but are not observed.

Paths are simulated with random decisions, which are the same on all paths up to the tested state.
A number of the state is named if

- with decisions held fixed, noise can move it while the observation stays the same to first order:
  it then differs between paths with the same observation. Functions of observations and time do
  not;
- later payments depend on it, by an amount, and by a factor, that depends on the decisions. For a
  number that only accumulates payments the amount is the same for all decisions, and for wealth
  that is invested in shares the factor is the same: observing it would change no decision.

A discrete number, such as the state of a chain, has no derivative: it is named if the observation
does not read it and it differs between the paths with the most similar observations.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .actions import squashed
from .quickly import compiled_sooner
from .scenarios import Supplied
from .simulator import at
from .smooth import Exact

PATHS, LOCAL, BEFORE = (
    128,
    8,
    8,
)  # paths; those with derivatives; steps before the state looked at, at most
MOVED, SEEN = 1e-9, 1e-6  # relative: a direction that is moved; one that is seen
LARGE = 0.2  # share of a number in a direction, all being in units of their deviation
ALIKE = 0.98  # of the paths' nearest neighbours have the same number, where it is determined
MATTERS = 0.02  # of the effect of exchanging the whole state
MAXIMUM = 12  # numbers whose effect is tested


def partly_observed(problem: Any) -> tuple[str, ...]:
    """The names of state numbers that matter and are not observed; see above."""
    simulator = problem.simulator
    if not problem.is_random or simulator.horizon < 2:
        return ()
    try:
        with jax.enable_x64(True):
            first = _start(problem)
            if _all_told(problem, first):
                return ()
            return tuple(_named(problem, first))
    except Exception:  # code of the user's own: a note is no reason to lose a run
        return ()


def note(names: tuple[str, ...], remembers: bool = False) -> str:
    """A note on the effect of partial observation on derivatives; empty if there is none."""
    if not names:
        return ""
    memory = (
        ""
        if remembers
        else (" A policy with a memory, snapo.GRU() or snapo.LastObservations(…), may do better.")
    )
    return (
        f"The observation does not contain all of the state that matters: {', '.join(names)}. "
        "Derivatives with decisions held fixed are then wrong in principle: use those through the "
        f"policy (smooth).{memory}"
    )


def _start(problem: Any) -> dict[str, Any]:
    """First states, and normals and decisions of all steps, decisions twice."""
    simulator, rng, T = problem.simulator, np.random.default_rng(0), problem.simulator.horizon
    source = problem.sources.evaluation
    paths = PATHS
    if isinstance(source, Supplied):
        drawn = source.draws(np.arange(source.available(PATHS)), simulator)
        noise, early = np.asarray(drawn.step_noise), np.asarray(drawn.initial_noise)
        paths = noise.shape[1]
    else:
        noise = rng.normal(size=(T, paths, simulator.noise_size))
        early = rng.normal(size=(paths, simulator.initial_noise_size))
    raw = rng.normal(size=(2, T, paths, simulator.action.size))
    actions = np.asarray(squashed(simulator.action, raw, Exact()))
    return {"early": early, "noise": noise.astype(float), "actions": actions}


def _all_told(problem: Any, first: dict[str, Any]) -> bool:
    """Whether the observation determines every number of a state by itself: nothing is hidden."""
    simulator, schedule = problem.simulator, problem.schedule
    early = np.asarray(first["early"][:LOCAL], float)
    state = jax.eval_shape(partial(simulator.initial, schedule.constants), early[0])
    if any(not _is_float(leaf) for leaf in jax.tree.leaves(state)):
        return False
    now = at(schedule.steps, 0)
    slopes = np.asarray(_first_slopes(simulator, schedule.constants, now, early))
    return bool(np.all(np.linalg.matrix_rank(slopes) == slopes.shape[2]))


def _named(problem: Any, first: dict[str, Any]) -> Iterator[str]:
    """The names, in the order of the state."""
    simulator, T = problem.simulator, problem.simulator.horizon
    t = max(1, min(BEFORE, T // 2))
    early, noise, actions = first["early"], first["noise"], first["actions"]
    same = np.broadcast_to(actions[0, :t, :1], actions[0, :t].shape)  # only noise differs
    states, moves = jax.tree.map(
        np.asarray, _reached(simulator, problem.schedule, early, noise[:t], same)
    )
    _, slopes = _observed(problem, jax.tree.map(lambda leaf: leaf[:LOCAL], states), t)
    numbers = _flat(states)
    hidden = _hidden(numbers, moves, np.asarray(slopes))
    complete, _ = _observed(problem, states, t)
    in_steps = _in_steps(problem, states, np.asarray(complete), t, moves)
    names = _names(states)
    requested = _paid_names(problem)
    tail = partial(_paid, simulator, problem.schedule, noise[t:], start=t)
    doubtful = np.flatnonzero(hidden | in_steps)[:MAXIMUM]
    if not doubtful.size:
        return

    def paid(states: PyTree) -> list[dict[str, Any]]:
        return [tail(actions[k, t:], states) for k in (0, 1)]

    before, others = paid(states), paid(jax.tree.map(lambda leaf: np.roll(leaf, 1, 0), states))
    for i in doubtful:
        after = paid(_swapped(states, int(i)))
        for name in requested & set(before[0]):
            one, two, *more = (np.asarray(item[name]) for item in (*before, *after, *others))
            if _matters(one, two, *more):
                yield names[int(i)]
                break


def _matters(one, two, first, second, all_one, all_two) -> bool:
    """Whether exchanging a number changes payments by more than the same amount, and by more than
    the same factor above 0, under two sequences of decisions.

    `one`, `two` [N]: payments under either sequence; `first`, `second`: with the number exchanged,
    `all_…`: with the whole state exchanged. Less than 2 % of that last effect is ignored.
    """
    minimum = MATTERS * max(_size(all_one - one), _size(all_two - two))
    added = _size((first - one) - (second - two)) <= minimum
    scale = np.maximum(np.abs(one), np.abs(two))
    apart = (first * two - second * one) / np.where(scale > 0, scale, 1.0)
    scaled = _size(apart) <= minimum and not np.any(first * one < 0)
    return not (added or scaled)


def _size(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(finite)))) if finite.size else 0.0


def _hidden(numbers: np.ndarray, moves: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """[n] whether a number moves in a direction that is moved and not seen, on most paths."""
    scale = np.where((deviation := numbers.std(0)) > 0, deviation, 1.0)
    counted = np.zeros(len(scale))
    for move, slope in zip(moves / scale[:, None], slopes * scale):
        if not (np.isfinite(move).all() and np.isfinite(slope).all()):
            continue
        left, size, _ = np.linalg.svd(move, full_matrices=False)
        basis = left[:, size > MOVED * max(size.max(initial=0.0), MOVED)]
        if not basis.size:
            continue
        rows = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)
        _, size, right = np.linalg.svd(rows @ basis, full_matrices=True)
        rank = int(np.sum(size > SEEN * max(size.max(initial=0.0), SEEN)))
        counted += np.linalg.norm(basis @ right[rank:].T, axis=1) > LARGE
    return counted > len(moves) / 2


def _in_steps(problem: Any, states: PyTree, observed: np.ndarray, t: int, moves: np.ndarray):
    """[n] whether a number moves in steps, is not read, and differs where paths look the same."""
    numbers, steps = _flat(states), np.zeros(_flat(states).shape[1], bool)
    still = ~np.any(moves != 0, axis=(0, 2))
    look = (observed - observed.mean(0)) / np.where(observed.std(0) > 0, observed.std(0), 1.0)
    far = np.linalg.norm(look[:, None] - look[None], axis=2)
    np.fill_diagonal(far, np.inf)
    nearest = far.argmin(1)
    for i in np.flatnonzero(still & (numbers.std(0) > 0)):
        summary = np.mean(numbers[nearest, i] == numbers[:, i]) >= ALIKE
        read = np.any(np.asarray(_observed(problem, _swapped(states, int(i)), t)[0]) != observed)
        steps[i] = not summary and not read
    return steps


def _observed(problem: Any, states: PyTree, t: int):
    """[N, features] the observations, [N, features, n] their derivatives with respect to the
    state."""
    constants, now = problem.schedule.constants, at(problem.schedule.steps, t)
    return _seen(problem.simulator, constants, now, states)


@compiled_sooner
def _seen(simulator, constants, now, states):
    return _with_slopes(simulator, constants, now, states)


@compiled_sooner
def _first_slopes(simulator, constants, now, early):
    states = jax.vmap(partial(simulator.initial, constants))(early)
    return _with_slopes(simulator, constants, now, states)[1]


def _with_slopes(simulator, constants, now, states):
    """[N, features] the observations, and [N, features, n] their derivatives."""

    def one(state):
        def look(vector):
            return simulator.observe(constants, now, _with(state, vector))

        vector = _vector(state)
        return look(vector), jax.jacfwd(look)(vector)

    return jax.vmap(one)(states)


@compiled_sooner
def _reached(simulator, schedule, early, noise, actions):
    """The states after some steps, and [LOCAL, n, drawn] how normals move them."""

    def after(values, actions):
        early, noise = values
        state = simulator.initial(schedule.constants, early)

        def one(state, t):
            now = at(schedule.steps, t)
            step = simulator.step(schedule.constants, now, state, actions[t], noise[t], Exact())
            return _like(step[0], state), None

        return jax.lax.scan(one, state, jnp.arange(len(noise)))[0]

    def slopes(inputs, actions):
        result = jax.jacfwd(lambda params: _vector(after(params, actions)))(inputs)
        flat = [leaf.reshape(leaf.shape[0], -1) for leaf in jax.tree.leaves(result)]
        return jnp.concatenate(flat, axis=1)

    every = (early, jnp.swapaxes(noise, 0, 1)), jnp.swapaxes(actions, 0, 1)
    few = jax.tree.map(lambda leaf: leaf[:LOCAL], every)
    return jax.vmap(after)(*every), jax.vmap(slopes)(*few)


@compiled_sooner
def _paid(simulator, schedule, noise, actions, states, start):
    """{output: [N]} the sum of all that is paid from these states on."""

    def complete(state, noise, actions):
        def one(state, inputs):
            t, noise, action = inputs
            now = at(schedule.steps, t)
            step = simulator.step(schedule.constants, now, state, action, noise, Exact())
            return _like(step[0], state), step[1]

        values = (start + jnp.arange(len(noise)), noise, actions)
        last, outputs = jax.lax.scan(one, state, values)
        paid = {name: jnp.sum(output) for name, output in outputs.items()}
        for name, item in simulator.terminal(schedule.constants, last, Exact()).items():
            paid[name] = paid.get(name, 0.0) + item
        return paid

    return jax.vmap(complete)(states, jnp.swapaxes(noise, 0, 1), jnp.swapaxes(actions, 0, 1))


def _paid_names(problem: Any) -> set[str]:
    """The outputs of the objective and of the limits."""
    return {
        name
        for item in (problem.objective, *(limit.measure for limit in problem.constraints))
        for name in item.outputs
    }


def _is_float(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _vector(state: PyTree) -> jax.Array:
    """All numbers of a state in one row, those in steps as constants."""
    leaves = [
        jnp.ravel(leaf).astype(float) if _is_float(leaf)
        else jax.lax.stop_gradient(jnp.ravel(leaf).astype(float))
        for leaf in jax.tree.leaves(state)
    ]  # fmt: skip
    return jnp.concatenate(leaves) if leaves else jnp.zeros(0)


def _with(state: PyTree, vector: jax.Array) -> PyTree:
    """The state with these numbers; those in steps keep theirs."""
    leaves, structure = jax.tree.flatten(state)
    parts, position = [], 0
    for leaf in leaves:
        size = jnp.size(leaf)
        part = vector[position : position + size].reshape(jnp.shape(leaf))
        parts.append(part.astype(jnp.result_type(leaf)) if _is_float(leaf) else leaf)
        position += size
    return structure.unflatten(parts)


def _like(after: PyTree, before: PyTree) -> PyTree:
    return jax.tree.map(lambda new, old: jnp.asarray(new, jnp.result_type(old)), after, before)


def _flat(states: PyTree) -> np.ndarray:
    """[N, n] all numbers of many states."""
    leaves = jax.tree.leaves(states)
    return np.concatenate([np.asarray(x, float).reshape(len(x), -1) for x in leaves], axis=1)


def _swapped(states: PyTree, number: int) -> PyTree:
    """The states, of which one number is that of the next path."""
    leaves, structure = jax.tree.flatten(states)
    results, position = [], 0
    for leaf in leaves:
        rows = np.array(leaf).reshape(len(leaf), -1)
        if position <= number < position + rows.shape[1]:
            rows[:, number - position] = np.roll(rows[:, number - position], 1)
        position += rows.shape[1]
        results.append(rows.reshape(np.shape(leaf)))
    return structure.unflatten(results)


def _names(states: PyTree) -> list[str]:
    """The name of every number: "water", "level.0", as in `snapo.simulate`."""
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(states)[0]:
        name = ".".join(str(getattr(part, "key", getattr(part, "idx", part))) for part in path)
        size = int(np.prod(np.shape(leaf)[1:]))
        name = name.lstrip(".") or "state"
        names += [f"{name}.{i}" for i in range(size)] if size > 1 else [name]
    return names
