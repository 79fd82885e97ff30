"""Norm of a path's adjoint at every step, which shows whether derivatives explode."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, PyTree

from snapo.problem.noise.counter import Draws, only
from snapo.problem.policy import Policy
from snapo.problem.problem import Problem
from snapo.problem.quickly import compiled_sooner

from .arrays import Packing, add, zero
from .xla import Xla, XlaCall

BLOCK = 64  # paths at once


class Norms(NamedTuple):
    """Norms of paths' adjoints at the state before every step, in float32.

    - `total` [T, N]: the norm over all numbers of the state; `leaves` {name: [T, N]}: the norm of
      every leaf by itself.
    """

    total: np.ndarray
    leaves: dict[str, np.ndarray]


def adjoint_norms(
    problem: Problem,
    policy: Policy,
    draws: Draws,
    smooth: Any,
    weights: Mapping[str, ArrayLike],
    memory: int | None = None,
) -> Norms:
    """The norm of each path's adjoint at every step, for the whole state and for its leaves.

    The adjoint of sum(weights x totals), times the simulator's `state_scale`, divided by the path's
    largest weight: the number that `Clip` bounds. XLA computes it. With `memory` the horizon is
    divided into parts of this number of steps, and no adjoint passes from one part to the part
    before it.
    """
    engine = Xla("float32")
    # A step may take a minute to compile: multiples of a block share one kernel.
    parts = np.array_split(np.arange(draws.size), max(1, draws.size // BLOCK))
    norms = []
    for selected in parts:
        local = {
            name: jnp.asarray(weight, jnp.float32)[selected] for name, weight in weights.items()
        }
        call = engine.call(
            problem.simulator, policy, problem.schedule, only(draws, selected), smooth
        )
        with call.compile_context():
            norms.append(_norms(engine, call, local, jnp.asarray(memory or call.length)))
    complete, leaves = jax.tree.map(lambda *item: np.concatenate(item).T, *norms)
    return Norms(complete, leaves)


@compiled_sooner  # it runs a few times: in a pension fund compiling took 13 s of processor time
def _norms(engine: Xla, call: XlaCall, weights: dict[str, Array], memory: Array):
    def of_path(draws, local):
        return _of_path(engine, call, draws, local, memory)

    return jax.vmap(of_path, (call.draws.axes(), 0))(call.draws, weights)


def _of_path(engine: Xla, call: XlaCall, draws, weights: dict[str, Array], memory: Array):
    """[T] of one path, and of every leaf: derivatives with respect to a perturbation of the state
    before each step."""
    simulator, constants, dtype = call.simulator, call.schedule.constants, engine.dtype
    initial = simulator.initial(constants, draws.initial(simulator.initial_noise_size, dtype))
    packing, kinds = Packing(initial, dtype), simulator.totals()
    start = packing.pack(initial)
    if dtype not in packing.kinds:  # a state of whole numbers has no adjoint
        return jnp.zeros(call.length), {}
    position = packing.kinds.index(dtype)

    def step(carry, x):
        packed, totals = carry
        now, drawn, nudge, first = x
        packed = tuple(jnp.where(first, jax.lax.stop_gradient(part), part) for part in packed)
        packed = tuple(part + nudge if i == position else part for i, part in enumerate(packed))
        state = packing.unpack(packed)
        action = call.policy(simulator.observe(constants, now, state), call.smooth)  # pyright: ignore
        noise = draws.noise(drawn, simulator.noise_size, dtype)
        after, outputs = simulator.step(constants, now, state, action, noise, call.smooth)
        totals = {
            name: add(kinds.get(name, "sum"), totals.get(name), jnp.asarray(value, dtype))
            for name, value in outputs.items()
        }
        return (packing.pack(after), totals), None

    def value(nudges):
        firsts = jnp.arange(call.length) % memory == 0
        xs = call.schedule.steps, draws.steps(call.first, call.length), nudges, firsts
        names = jax.eval_shape(step, (start, {}), jax.tree.map(lambda leaf: leaf[0], xs))[0][1]
        totals = {name: zero(kinds.get(name, "sum"), dtype) for name in names}
        (packed, totals), _ = jax.lax.scan(jax.checkpoint(step), (start, totals), xs)
        for name, value in simulator.terminal(
            constants, packing.unpack(packed), call.smooth
        ).items():
            value = jnp.asarray(value, dtype)
            totals[name] = add(kinds.get(name, "sum"), totals.get(name), value)
        return sum((weight * totals[name] for name, weight in weights.items()), jnp.zeros(()))

    size = jnp.stack([jnp.abs(weight) for weight in weights.values()]).max()
    slopes = jax.grad(value)(jnp.zeros((call.length, start[position].size), dtype))
    scale = simulator.state_scale(constants)
    if scale is not None:
        slopes = slopes * packing.pack(scale)[position]
    size = jnp.maximum(size, jnp.finfo(dtype).tiny)
    leaves = {
        name: jnp.linalg.norm(slopes[:, first:last], axis=1) / size
        for name, first, last in _places(initial, dtype)
    }
    return jnp.linalg.norm(slopes, axis=1) / size, leaves


def _places(state: PyTree, dtype) -> list[tuple[str, int, int]]:
    """Each leaf of real numbers in the packed state: its name, first and last place."""
    rows, first = [], 0
    for path, leaf in jax.tree.leaves_with_path(state):
        if jnp.issubdtype(jnp.asarray(leaf).dtype, jnp.floating):
            name, size = jax.tree_util.keystr(path, simple=True, separator="."), jnp.size(leaf)
            rows.append((name.removeprefix("own.") or "state", first, first + size))
            first += size
    return rows
