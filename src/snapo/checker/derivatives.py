"""Derivatives that are not finite: the method, the argument and the step at which one appears."""

from typing import NoReturn

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snapo.problem.simulator import Simulator

from .findings import Notes, StopCheck
from .rollout import CheckedRollout

NOT_DIFFERENTIABLE = (
    "A root, logarithm, power or division at zero has no derivative, even inside a branch that "
    "jnp.where does not take: give the branch a harmless argument, f(jnp.where(ok, x, 1.0)), too."
)


def locate(notes: Notes, simulator: Simulator, run: CheckedRollout) -> NoReturn:
    """Names the method and step at which a derivative is not finite, and stops.

    The reverse sweep starts at the end, so the last bad step is the one met first.
    """
    constants, T, N = run.schedule.constants, simulator.horizon, run.draws.size

    def finite(function, *arguments):
        """{argument: whether d(sum of floating results) / d argument is finite}, for one path."""
        moving, fixed = eqx.partition(arguments, eqx.is_inexact_array)

        def total(moving):
            results = jax.tree.leaves(function(*eqx.combine(moving, fixed)))
            return sum(jnp.sum(x) for x in results if jnp.issubdtype(x.dtype, jnp.floating))

        return jax.tree.map(lambda g: jnp.all(jnp.isfinite(g)), jax.grad(total)(moving))

    def one(now, state, action, noise):
        def step(state, now, action, constants):
            return simulator.step(constants, now, state, action, noise, run.smooth)

        def observe(state, now, constants):
            return simulator.observe(constants, now, state)

        return {
            "step": finite(step, state, now, action, constants),
            "observe": finite(observe, state, now, constants),
        }

    with jax.enable_x64(True):
        mapped = jax.jit(lambda xs: jax.lax.map(lambda x: jax.vmap(one, (None, 0, 0, 0))(*x), xs))
        marks = mapped((run.schedule.steps, run.states, run.actions, run.draws.step_noise))
        marks = jax.tree.map(np.asarray, marks)
    names = {
        "step": ("state", "now", "action", "constants"),
        "observe": ("state", "now", "constants"),
    }
    invalid = []
    for method, arguments in names.items():
        for path, ok in jax.tree_util.tree_flatten_with_path(marks[method])[0]:
            if not ok.all():
                step, number = (int(i) for i in np.argwhere(~ok)[-1])
                leaf = arguments[path[0].idx] + jax.tree_util.keystr(path[1:])
                invalid.append((step, method, leaf, number))
    if invalid:
        step, method, leaf, path = max(invalid)
        notes.error(
            notes.method(method),
            f"Its derivative by {leaf} is not finite, first (from the end) at step {step} of {T} "
            f"(path {path} of {N}).",
            NOT_DIFFERENTIABLE,
        )
    else:
        notes.error(
            notes.method("initial") + " or terminal",
            "A derivative is not finite.",
            NOT_DIFFERENTIABLE,
        )
    raise StopCheck
