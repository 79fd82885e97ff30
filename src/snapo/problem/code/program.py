"""Programs as text: two traces that read the same things are the same text."""

import re
from collections.abc import Callable
from hashlib import blake2b
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .. import inputs as inputs_
from ..smooth import Exact, Smooth

ProgramText = tuple[str, tuple[bytes, ...]]


def text(function: Callable[..., Any], *arguments: Any) -> ProgramText:
    """A function's program without the addresses in its print, and digests of its constants.

    `function` must be a new one: JAX keeps the traces of those that it has met.
    """
    closed = jax.make_jaxpr(function)(*arguments)
    constants = tuple(blake2b(np.asarray(const).tobytes()).digest() for const in closed.consts)
    return re.sub(r"0x[0-9a-f]+", "", str(closed.jaxpr)), constants


def preparation(simulator: Any, inputs: PyTree) -> ProgramText:
    """The program of `prepare`."""
    return text(lambda v: simulator.prepare(inputs_.replace(inputs, v)), inputs_.values(inputs))


def path(simulator: Any, policy: Any) -> Callable[..., Any]:
    """One path's start, step and end, exact and smooth."""

    def step(constants, now, initial, noise, action) -> Any:
        state = simulator.initial(constants, initial)
        made = [state, simulator.state_scale(constants)]
        for smooth in (Exact(), Smooth(0.1)):
            observed = simulator.observe(constants, now, state)
            decided = action if policy is None else policy(observed, smooth)
            after, outputs = simulator.step(constants, now, state, decided, noise, smooth)
            made += [observed, after, outputs, simulator.terminal(constants, state, smooth)]
            made.append(dict(simulator.slack(constants, now, after, outputs)))
        return eqx.filter(made, eqx.is_array)

    return step


def rollout(simulator: Any, policy: Any, schedule: Any) -> Any:
    """The program of one step and of the end, exact and smooth, with all that is declared."""
    sizes = simulator.initial_noise_size, simulator.noise_size, simulator.action.size
    now = jax.tree.map(lambda leaf: jnp.asarray(leaf)[0], schedule.steps)
    vectors = [jnp.zeros(size) for size in sizes]
    made = text(
        path(simulator, policy), jax.tree.map(jnp.asarray, schedule.constants), now, *vectors
    )
    return made, sizes, dict(simulator.totals()), simulator.control_variates()
