"""The XLA engine: one path, mapped over paths, scanned over time, compiled by JAX.

It always works: on a CPU, on a GPU and on many devices. Its adjoint is JAX's reverse mode of the
rollout with the body of every step rematerialised; it is the oracle of the native engine in tests.
"""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P
from jax.typing import ArrayLike
from jaxtyping import Array, PyTree

from snapo.problem.code.version import of_rollout, read_context
from snapo.problem.noise import Counter, Draws
from snapo.problem.policy import Policy
from snapo.problem.simulator import Schedule, Simulator

from .arrays import Packing, add, adjoint_without, values_without, with_memory, zero
from .base import Adjoint, Clip, Engine, Rollout, Window, cast, checked, clipped

NOISE_BYTES = 1 << 28  # noise is kept for one call up to this size


@dataclass(frozen=True)
class Xla(Engine):
    """Rollouts by `jax.vmap` and `jax.lax.scan`.

    **Arguments:**

    - `precision`: "float32" (training) or "float64" (values and sensitivities).
    - `segments`: the horizon is divided into this many segments, whose states are computed again in
      the adjoint, so that it stores T / segments + segments states instead of T; None stores the
      state of every step.
    - `devices`: the paths are sharded over these JAX devices, if the number of paths is a multiple
      of that of the devices; None uses the default device.
    """

    segments: int | None = None
    devices: tuple[Any, ...] | None = None

    def numbers(self) -> AbstractContextManager:
        """As for other engines, with full precision of products: by default a GPU rounds float32
        factors to ten bits, which changes gradients by a thousandth."""
        kind = jax.default_backend() if self.devices is None else self.devices[0].platform
        if self.precision == "float64" or kind == "cpu":
            return super().numbers()
        return jax.default_matmul_precision("highest")

    def values(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        *,
        actions: ArrayLike | None = None,
        record: tuple[str, ...] = (),
        window: Window | None = None,
        start: PyTree = None,
    ) -> Rollout:
        with self.numbers():
            call = self.call(simulator, policy, schedule, draws, smooth, actions, window, start)
            with call.compile_context():
                result = self.leave(_values(self, call, record))
            return values_without(simulator, call.simulator, result)

    def adjoint(
        self,
        simulator: Simulator,
        policy: Policy | None,
        schedule: Schedule,
        draws: Draws,
        smooth,
        weights: Mapping[str, ArrayLike],
        *,
        actions: ArrayLike | None = None,
        clip: Clip | None = None,
        window: Window | None = None,
        start: PyTree = None,
        wrt: tuple[str, ...] = ("policy", "schedule", "start"),
    ) -> Adjoint:
        with self.numbers():
            call = self.call(simulator, policy, schedule, draws, smooth, actions, window, start)
            values = {name: cast(weight, self.dtype) for name, weight in weights.items()}
            # The bounds are an array: other ones compile nothing.
            bounds = None if clip is None else jnp.asarray(clip.bounds(values))
            with call.compile_context():
                result = self.leave(_adjoint(self, call, values, bounds, wrt))
            return adjoint_without(simulator, call.simulator, result)

    def call(
        self, simulator, policy, schedule, draws, smooth, actions=None, window=None, start=None
    ) -> "XlaCall":
        """The checked arguments of a rollout, in this engine's precision and on its devices."""
        simulator, start = with_memory(simulator, policy, actions, start, draws.size)
        window = checked(simulator, policy, schedule, draws, actions, window)
        is_last = window.is_last(simulator.horizon)
        differentiable, fixed = eqx.partition(
            cast((policy, schedule, start, actions), self.dtype), eqx.is_inexact_array
        )
        policy, schedule, start, actions = eqx.combine(differentiable, fixed)
        start, actions, draws = jax.tree.map(jnp.asarray, (start, actions, draws))
        first = jnp.asarray(window.first, jnp.int32)
        smooth = cast(smooth, self.dtype)
        return XlaCall(
            simulator,
            policy,
            schedule,
            draws,
            smooth,
            actions,
            start,
            first,
            window.length,
            is_last,
        )

    def traced(self, call: "XlaCall", record: tuple[str, ...] = ()) -> Rollout:
        """The rollout as plain JAX, for callers that differentiate it themselves."""
        return _rollout(self, call, record, None)


class XlaCall(eqx.Module):
    """Everything a rollout needs, in the engine's precision."""

    simulator: Simulator
    policy: Policy | None
    schedule: Schedule
    draws: Draws
    smooth: Any
    actions: Any
    start: PyTree
    first: Array
    length: int = eqx.field(static=True)
    has_terminal: bool = eqx.field(static=True)

    def compile_context(self) -> AbstractContextManager:
        """The context of every compiled call: it depends on the values that the user's code
        reads."""
        return read_context(of_rollout(self.simulator, self.policy, self.schedule, self.smooth))

    def axes(self) -> "XlaCall":
        """The axis of paths of every array, None if it has none."""
        none = jax.tree.map(lambda leaf: None, self)
        start = jax.tree.map(lambda leaf: 0, self.start)
        actions = None if self.actions is None else 1
        return replace(none, draws=self.draws.axes(), start=start, actions=actions)


class _Carry(NamedTuple):
    state: tuple[Array, ...]
    totals: dict[str, Array]


@eqx.filter_jit
def _values(engine: Xla, call: XlaCall, record: tuple[str, ...]) -> Rollout:
    def some(call):
        return _rollout(engine, call, record, None)

    return Rollout(*_over_devices(engine, some, (call,), (call.axes(),), (0, 0, 1)))


@eqx.filter_jit
def _adjoint(
    engine: Xla,
    call: XlaCall,
    weights: dict[str, Array],
    bounds: Array | None,
    wrt: tuple[str, ...],
) -> Adjoint:
    def some(call, weights, bounds):
        return _pulled_back(engine, call, weights, bounds, wrt)

    batched = any(weight.ndim == 2 for weight in weights.values())
    weight_axes = jax.tree.map(lambda weight: weight.ndim - 1, weights)
    axes = call.axes(), weight_axes, None if bounds is None else 0
    out = (0, None, None, int(batched))
    return Adjoint(*_over_devices(engine, some, (call, weights, bounds), axes, out))


def _over_devices(engine: Xla, work, values, axes, out):
    """`work` on every device's share of the paths; results without an axis of paths are summed.

    Each device simulates only its own paths, and the gradients are added once, at the end. If the
    arrays were only sharded over the devices, XLA would add them up at every step.
    """
    size = values[0].draws.size
    if engine.devices is None or size % len(engine.devices):
        return work(*values)

    def spec(axis):
        return P() if axis is None else P(*(None,) * axis, "paths")

    def share(arrays):
        result = work(*eqx.combine(arrays, rest))
        return tuple(
            jax.lax.psum(part, "paths") if axis is None else part for part, axis in zip(result, out)
        )

    arrays, rest = eqx.partition(values, eqx.is_array)
    where = jax.tree.map(lambda _, axis: spec(axis), arrays, axes, is_leaf=lambda x: x is None)
    mesh = Mesh(np.asarray(engine.devices), ("paths",))
    outs = tuple(map(spec, out))
    return jax.shard_map(share, mesh=mesh, in_specs=(where,), out_specs=outs, check_vma=False)(
        arrays
    )


def _pulled_back(engine: Xla, call: XlaCall, weights, bounds: Array | None, wrt) -> Adjoint:
    """Totals, and the gradient of their weighted sum."""
    moving, fixed = eqx.partition({name: getattr(call, name) for name in wrt}, eqx.is_inexact_array)

    def weighted(moving):
        new = replace(call, **eqx.combine(moving, fixed))
        totals = _rollout(engine, new, (), bounds).totals
        # Only outputs with a weight are differentiated.
        return {name: totals[name] for name in weights}, totals

    _, pull, totals = jax.vjp(weighted, moving, has_aux=True)
    batched = any(w.ndim == 2 for w in weights.values())
    gradient = jax.vmap(pull)(weights)[0] if batched else pull(weights)[0]
    return Adjoint(totals, *(gradient.get(name) for name in ("policy", "schedule", "start")))


def _rollout(engine: Xla, call: XlaCall, record, bounds) -> Rollout:
    """All paths at once: `_path` mapped over the paths' arrays."""

    noise = _noise(engine, call)

    def one(draws, noise, start, actions, clip):
        return _path(engine, call, draws, noise, start, actions, record, clip)

    values = (call.draws, noise, call.start, call.actions, bounds)
    axes = (
        call.draws.axes(),
        *(None if x is None else a for x, a in zip(values[1:], (1, 0, 1, 0))),
    )
    out = Rollout(0, 0, dict.fromkeys(record, 1))  # pyright: ignore[reportArgumentType]
    return jax.vmap(one, in_axes=axes, out_axes=out)(*values)


def _noise(engine: Xla, call: XlaCall) -> Array | None:
    """All noise [length, N, K] drawn in one go, unless it is too large to keep.

    XLA draws it several times faster that way than inside the scan; the numbers are the same.
    """
    size, draws, dtype = call.simulator.noise_size, call.draws, engine.dtype
    if not isinstance(draws, Counter):
        return None
    # Segments are asked for to save memory: then nothing is kept.
    if engine.segments or call.length * draws.size * size * dtype.itemsize > NOISE_BYTES:
        return None

    def one(draws, step):
        return draws.noise(step, size, dtype)

    paths = jax.vmap(one, in_axes=(draws.axes(), None))
    return jax.vmap(paths, in_axes=(None, 0))(draws, draws.steps(call.first, call.length))


def _path(
    engine: Xla, call: XlaCall, draws, noise, start, actions, record, clip: Array | None
) -> Rollout:
    """One path through the window."""
    simulator, policy, schedule, smooth = call.simulator, call.policy, call.schedule, call.smooth
    constants, dtype = schedule.constants, engine.dtype
    first, length = call.first, call.length
    if start is None:
        start = simulator.initial(constants, draws.initial(simulator.initial_noise_size, dtype))
    packing = Packing(start, dtype)
    kinds = simulator.totals()

    def step(carry: _Carry, x):
        now, noise, action = x
        packed = (
            carry.state
            if clip is None
            else clipped(carry.state, packing, simulator, constants, clip)
        )
        state = packing.unpack(packed)
        if action is None:
            action = policy(simulator.observe(constants, now, state), smooth)  # pyright: ignore
        drawn = noise if stored else draws.noise(noise, simulator.noise_size, dtype)
        after, outputs = simulator.step(constants, now, state, action, drawn, smooth)
        outputs = {name: jnp.asarray(value, dtype) for name, value in outputs.items()}
        retained = {"state": state, "action": action, "outputs": outputs}
        if "slack" in record:
            retained["slack"] = dict(simulator.slack(constants, now, after, outputs))
        totals = {
            name: add(kinds.get(name, "sum"), carry.totals.get(name), v)
            for name, v in outputs.items()
        }
        return _Carry(packing.pack(after), totals), {name: retained[name] for name in record}

    now = jax.tree.map(
        lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, length), schedule.steps
    )
    stored = noise is not None
    xs = (now, noise if stored else draws.steps(first, length), actions)
    shapes = jax.eval_shape(
        step, _Carry(packing.pack(start), {}), jax.tree.map(lambda leaf: leaf[0], xs)
    )
    zeros = {name: zero(kinds.get(name, "sum"), dtype) for name in shapes[0].totals}
    carry = _Carry(packing.pack(start), zeros)
    carry, selected = _scan(
        jax.checkpoint(step, prevent_cse=False), carry, xs, length, engine.segments
    )
    state = packing.unpack(carry.state)
    totals = dict(carry.totals)
    if call.has_terminal:
        for name, value in simulator.terminal(constants, state, smooth).items():
            totals[name] = add(kinds.get(name, "sum"), totals.get(name), jnp.asarray(value, dtype))
    return Rollout(totals, state, selected)


def _scan(step, carry, xs, length: int, segments: int | None):
    """`lax.scan`, with rematerialised segments if requested: memory grows like the root of the
    horizon."""
    if segments is None or segments < 2 or length < 4:
        return jax.lax.scan(step, carry, xs)
    size = -(-length // min(segments, length))
    complete = length // size * size

    @jax.checkpoint
    def segment(carry, xs):
        return jax.lax.scan(step, carry, xs)

    head = jax.tree.map(lambda leaf: leaf[:complete].reshape(-1, size, *leaf.shape[1:]), xs)
    carry, selected = jax.lax.scan(segment, carry, head)
    selected = jax.tree.map(lambda leaf: leaf.reshape(complete, *leaf.shape[2:]), selected)
    carry, rest = segment(carry, jax.tree.map(lambda leaf: leaf[complete:], xs))
    return carry, jax.tree.map(lambda a, b: jnp.concatenate([a, b]), selected, rest)


def weighted_sum(totals, weights) -> Array:
    """Sum over outputs and paths of weight x total."""
    return sum(
        (jnp.sum(jnp.asarray(w) * totals[name]) for name, w in weights.items()), jnp.zeros(())
    )
