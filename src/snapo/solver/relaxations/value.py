"""An approximate value of a stopping problem, by regression on simulated paths.

Backwards in time, the worth of waiting is fitted to the value a step later (Longstaff and
Schwartz 2001; Tsitsiklis and Van Roy 2001), and the value is the better one of stopping and
waiting. It is used for penalties alone: its error widens a bound, and never makes it wrong.
"""

from itertools import combinations_with_replacement
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from snapo.engine import Xla
from snapo.problem.code.version import followed
from snapo.problem.scenarios import Scenarios
from snapo.problem.simulator import at
from snapo.problem.smooth import Exact

from .decisions import Decisions, states_of

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
    """How the numbers [d] of one step are measured: less `centre`, times `per`."""

    centre: Float[Array, " d"]
    per: Float[Array, " d"]

    @classmethod
    def of(cls, numbers: Float[np.ndarray, "paths d"]) -> "Scale":
        """From a sample; a number that is the same on all paths counts as zero."""
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
    """The value of the better decision, from the worth of what is left afterwards."""
    waiting, using = earnings[:, 0] + after, earnings[1:, 1] + after[:-1]
    return jnp.concatenate([waiting[:1], jnp.maximum(waiting[1:], using)])


def basis_and_earnings(
    decisions: Decisions, schedule, t: Array, state: PyTree
) -> tuple[Array, Array]:
    """One path: the numbers of the basis, and every decision's earnings where no noise comes."""
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
