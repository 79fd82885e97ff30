"""The phases of a rollout as functions of flat lists of arrays.

    initial    noise or given states        ->  carry
    step       carry, noise (and actions)   ->  carry, records
    final      carry                        ->  totals, state

The carry is the state's leaves and the running totals. Between the phases only arrays flow, so
each is compiled for itself and differentiated for itself.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from snapo.lanes.program.cut import evaluate
from snapo.lanes.unsupported import Unsupported

from ..base import factor_of
from ..totals import add
from .given import floating, jax_type


@dataclass(frozen=True)
class FunctionSetup:
    """The purpose of a kernel, beside the simulator, the policy and the types of arrays."""

    dtype: str
    adjoint: bool
    record: tuple[str, ...]
    actions: bool
    start: bool
    has_terminal: bool
    clip: bool
    wrt: tuple[str, ...]
    counter: bool
    antithetic: bool


class Functions:
    """The phases as functions of flat lists of arrays."""

    def __init__(self, setup: FunctionSetup, dtype, segments, current, calls: int, nows: int):
        self.setup, self.dtype = setup, dtype
        self.segments, self.current = segments, current
        self.calls, self.nows = calls, nows

    def describe(self, call, now, state_like, noise_sizes, action_size) -> None:
        """Shapes of states, outputs and records, and the one trace of the user's step."""
        real = self.dtype
        self.noise = [jax.ShapeDtypeStruct((n,), real) for n in noise_sizes]
        self.action = jax.ShapeDtypeStruct((action_size,), real)
        if state_like is None:

            def first(call, noise):
                _, constants, _, simulator = self.segments(call)
                return simulator.initial(constants, noise)

            state_like = jax.eval_shape(first, call, self.noise[1])
        leaves, self.state_tree = jax.tree.flatten(state_like)
        self.state = [jax.ShapeDtypeStruct(x.shape, self._kind(x)) for x in leaves]

        values = call, now, self.state, self.noise[0], self.action
        self.once, selected = jax.make_jaxpr(self._outputs, return_shape=True)(*values)
        if self.once.effects:
            raise Unsupported("a callback, such as jax.debug.print, in step")
        self.after, self.names = jax.tree.structure(selected), list(selected[1])
        self.record_tree = jax.tree.structure(selected[2])

        def last(call, state):
            _, constants, smooth, simulator = self.segments(call)
            return simulator.terminal(constants, self._state(state), smooth)

        ending = jax.eval_shape(last, call, self.state) if self.setup.has_terminal else {}
        self.final_names = [*self.names, *(n for n in ending if n not in self.names)]

    def _kind(self, x):
        dtype = np.dtype(x.dtype)
        return self.dtype if np.issubdtype(dtype, np.floating) else jax_type(x)

    def _state(self, leaves):
        return jax.tree.unflatten(self.state_tree, leaves)

    def _leaves(self, state) -> list[Any]:
        """A state's leaves in their types; their shapes may not change."""
        leaves = [jnp.asarray(x) for x in self.state_tree.flatten_up_to(state)]
        for leaf, available in zip(leaves, self.state):
            if leaf.shape != available.shape:
                raise ValueError(
                    f"The state changes shape: `initial` gives {available.shape} "
                    f"where `step` gives {leaf.shape}."
                )
        return [leaf.astype(valid.dtype) for leaf, valid in zip(leaves, self.state)]

    def _outputs(self, call, now, leaves, noise, action):
        policy, constants, smooth, simulator = self.segments(call)
        now, state = self.current(now), self._state(leaves)
        if not self.setup.actions:
            action = policy(simulator.observe(constants, now, state), smooth)
            # The same step follows in a kernel that reads recorded actions.
            action = jax.lax.optimization_barrier(jnp.asarray(action, self.dtype))
        after, outputs = simulator.step(constants, now, state, action, noise, smooth)
        outputs = {name: jnp.asarray(value, self.dtype) for name, value in outputs.items()}
        selected = {"state": state, "action": action, "outputs": outputs}
        if "slack" in self.setup.record:
            selected["slack"] = dict(simulator.slack(constants, now, after, outputs))
        return after, outputs, {name: selected[name] for name in self.setup.record}

    def _initial(self, *values):
        call, local = values[: self.calls], values[self.calls :]
        _, constants, _, simulator = self.segments(call)
        if self.setup.start:
            leaves = self._leaves(self._state(local))
        else:
            leaves = self._leaves(simulator.initial(constants, local[0]))
        kinds = simulator.totals()
        zeros = [-np.inf if kinds.get(n, "sum") == "max" else 0.0 for n in self.names]
        return [*leaves, *(jnp.asarray(z, self.dtype) for z in zeros)]

    def _step(self, *values):
        call, rest = values[: self.calls], values[self.calls :]
        now, local = rest[: self.nows], rest[self.nows :]
        n = len(self.state)
        leaves, totals, local = (
            local[:n],
            local[n : n + len(self.names)],
            local[n + len(self.names) :],
        )
        noise = local[0]
        action = local[1] if self.setup.actions else jnp.zeros(self.action.shape, self.dtype)
        result = evaluate(self.once, [*call, *now, *leaves, noise, action])
        after, outputs, selected = jax.tree.unflatten(self.after, result)
        kinds = self.segments(call)[3].totals()
        totals = [add(kinds.get(k, "sum"), t, outputs[k]) for k, t in zip(self.names, totals)]
        return [*self._leaves(after), *totals, *jax.tree.leaves(selected), *self._scales(call)]

    def _final(self, *values):
        call, local = values[: self.calls], values[self.calls :]
        n = len(self.state)
        totals = dict(zip(self.names, local[n:]))
        _, constants, smooth, simulator = self.segments(call)
        if self.setup.has_terminal:
            kinds = simulator.totals()
            for name, value in simulator.terminal(
                constants, self._state(local[:n]), smooth
            ).items():
                value = jnp.asarray(value, self.dtype)
                totals[name] = add(kinds.get(name, "sum"), totals.get(name), value)
        return [*(totals[name] for name in self.final_names), *local[:n]]

    def phases(self) -> Iterator[Any]:
        """(name, function, inputs, outputs, whether it sees the step) of every phase."""
        total = jax.ShapeDtypeStruct((), self.dtype)
        state = [(("state", i), x) for i, x in enumerate(self.state)]
        carry = [*state, *((("total", n), total) for n in self.names)]
        keys = [key for key, _ in carry]
        start = [(("start", i), x) for i, x in enumerate(self.state)]
        entry = start if self.setup.start else [("noise", self.noise[1])]
        local = [*carry, ("noise", self.noise[0])]
        local += [("action", self.action)] if self.setup.actions else []
        records = [("record", i) for i in range(self.record_tree.num_leaves)]
        final = [
            *(("final", n) for n in self.final_names),
            *(("end", i) for i in range(len(self.state))),
        ]
        yield "initial", self._initial, entry, keys, False
        yield "step", self._step, local, [*keys, *records], True
        yield "final", self._final, carry, final, False

    def clip(self) -> Callable | None:
        """Bounds and shrinks the cotangents of the state, not those of the totals (`Clip`)."""
        if not self.setup.clip:
            return None
        floats = [i for i, x in enumerate(self.state) if floating(x)]
        tiny = np.finfo(self.dtype).tiny

        def clip(back, outputs, values):
            scales = outputs[len(outputs) - len(floats) :]
            square = sum(jnp.sum((g * s) ** 2) for g, s in zip(back, scales))
            factor = factor_of(jnp.sqrt(jnp.maximum(square, tiny)), values)
            return [*(g * factor for g in back[: len(floats)]), *back[len(floats) :]]

        return clip if floats else None

    def _scales(self, call) -> list[Any]:
        """`state_scale` of every floating leaf of the state, where adjoints are clipped."""
        if not self.setup.clip:
            return []
        _, constants, _, simulator = self.segments(call)
        scale = simulator.state_scale(constants)
        leaves = [1.0] * len(self.state) if scale is None else self.state_tree.flatten_up_to(scale)
        return [
            jnp.broadcast_to(jnp.asarray(s, x.dtype), x.shape)
            for s, x in zip(leaves, self.state)
            if floating(x)
        ]
