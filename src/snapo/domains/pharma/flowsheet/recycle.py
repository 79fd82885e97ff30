"""The steady state of a loop of the flowsheet, by tearing and the implicit function theorem.

Some streams of the loop are torn: from a guess x the units compute them as g(x), and g(x) = x is
required. Newton's method solves this equation with the full Jacobian of g. If a step does not
reduce the residual, shorter steps are tried, and the substitution of x by g(x), which is always
possible. The search carries no derivatives. Two further steps with the matrix held fixed are
sufficient: with M the Jacobian of x - g at the solution, x - M^-1 (x - g(x)) has the derivative
M^-1 dg of the implicit function theorem, and after the second step second derivatives are exact
too.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..time.dynamics import Numerics
from .stream import Stream

# The guessed fields; the rest of a stream goes around the loop unchanged.
GUESSED = (
    "species", "solid", "seed", "solvent", "antisolvent", "volume", "solids", "temperature",
    "moments", "numbers",
)  # fmt: skip
TOGETHER = ("species", "solid", "seed")  # scaled by the largest amount among them
CARRIED = ("duration", "density", "shape", "inner_size", "inner_density")
SHARES = np.array([1.0, 0.5, 0.25, 0.1, 0.02])  # of a Newton step that are tried
BELOW = -1e-9  # round-off that makes a zero amount negative
ROUND_OFF = 1e3  # times the precision: smaller changes are round-off

Turn = Callable[[tuple[Stream, ...], Any], tuple[Stream, ...]]


class Closed(NamedTuple):
    """`change`: the relative change of the guess in one more iteration; `rounds`: the number of
    iterations; `worst`: which of `labels` changes most; `converged`: whether the change is within
    the tolerance."""

    change: Float[Array, ""]
    rounds: Float[Array, ""]
    worst: Float[Array, ""]
    converged: Float[Array, ""]


def labels(streams: tuple[Stream, ...], names: tuple[str, ...], species: tuple[str, ...]):
    """A description of every entry of the guess."""
    results = []
    for name, stream in zip(names, streams):
        for field in GUESSED:
            size = jnp.size(getattr(stream, field))
            of = species if field in TOGETHER else [""] if size == 1 else range(size)
            results += [f"{field} {item}".rstrip() + f" of {name}" for item in of]
    return results


def close(
    turn: Turn, guess: tuple[Stream, ...], around: Any, numerics: Numerics
) -> tuple[tuple[Stream, ...], Closed]:
    """The tear streams (NaN if no steady state was reached), and how the iteration ended.

    `turn(torn, around)`: the tear streams that the loop returns; `guess` has their shapes, and
    the duration of all flows; `around`: everything else, which has derivatives.
    """
    turn = jax.jit(turn)  # traced once, however often it is called and differentiated
    first = guess
    for _ in guess:
        first = tuple(
            old.replace(**{name: getattr(new, name) for name in CARRIED})
            for old, new in zip(guess, turn(first, around))
        )
    still = jax.lax.stop_gradient
    fixed, carried = still(around), still(first)
    size = _scales(still(turn(carried, fixed)))

    def gap(u: Array, like: tuple[Stream, ...], around) -> Array:
        return _vector(turn(_streams(u * size, like), around)) / size - u

    def at_rest(u: Array) -> Array:
        return gap(u, carried, fixed)

    u, slope, result, worst, rounds = _search(at_rest, _vector(carried) / size, numerics)
    precise = ROUND_OFF * jnp.finfo(u.dtype).eps
    valid = result <= jnp.maximum(numerics.loop_tolerance, precise)

    def polished(u, _):
        """One more Newton step, which supplies the last digits and the derivatives."""
        return u - jnp.linalg.solve(slope, gap(u, first, around)), None

    u, slope = still((jnp.where(valid, u, jnp.nan), slope))
    u, _ = jax.lax.scan(polished, u, length=2)
    return _streams(u * size, first), Closed(result, rounds, worst, valid)


def _search(gap: Callable[[Array], Array], start: Array, numerics: Numerics):
    """The zero of `gap`, from `start`, and its matrix there; the remaining change, the entry with
    this change, and the rounds of Newton's method."""

    def change(u, off):
        size = jnp.abs(off) / jnp.maximum(1.0, jnp.abs(u))
        possible = jnp.all(jnp.isfinite(off)) & jnp.all(u > BELOW)
        return jnp.where(possible, jnp.max(size), jnp.inf), jnp.argmax(size)

    def further(state):
        *_, left, rounds = state
        minimum = jnp.maximum(numerics.loop_tolerance, jnp.finfo(start.dtype).eps)
        return (left > minimum) & (rounds < numerics.loop_rounds)

    def better(state):
        u, off, slope, _, _, rounds = state
        move = -jnp.linalg.solve(slope, off)
        bumped = jnp.concatenate(
            [u + jnp.asarray(SHARES, u.dtype)[:, None] * move, (u + off)[None]]
        )
        left, worst = jax.vmap(change)(bumped, jax.vmap(gap)(bumped))
        best = jnp.argmin(left)
        # If none is possible, substitution continues, and the result will be refused.
        best = jnp.where(jnp.isfinite(left[best]), best, len(SHARES))
        u = bumped[best]
        slope, off = jax.jacfwd(lambda at: (gap(at),) * 2, has_aux=True)(u)
        return u, off, slope, worst[best], left[best], rounds + 1

    # The first round looks at the start itself: without a change all that is tried is there.
    position = jnp.argmax(start)
    state = (start, jnp.zeros_like(start), jnp.eye(len(start), dtype=start.dtype), position)
    infinite, before = jnp.full((), jnp.inf, start.dtype), jnp.full((), -1, position.dtype)
    u, _, slope, worst, left, rounds = jax.lax.while_loop(
        further, better, (*state, infinite, before)
    )
    return u, slope, left, worst, rounds


def _vector(streams: tuple[Stream, ...]) -> Float[Array, " K"]:
    return jnp.concatenate([jnp.ravel(getattr(s, name)) for s in streams for name in GUESSED])


def _streams(vector: Float[Array, " K"], like: tuple[Stream, ...]) -> tuple[Stream, ...]:
    """The streams of a vector from `_vector`, with the fields `CARRIED` as in `like`."""
    results, start = [], 0
    for item in like:
        fields = {}
        for name in GUESSED:
            shape = jnp.shape(getattr(item, name))
            end = start + int(np.prod(shape))
            fields[name] = vector[start:end].reshape(shape)
            start = end
        results.append(item.replace(**fields))
    return tuple(results)


def _scales(streams: tuple[Stream, ...]) -> Float[Array, " K"]:
    """For every entry its order of magnitude; 1 if all of its kind are zero."""
    results = []
    for stream in streams:
        amount = jnp.max(stream.species + stream.solid)
        for name in GUESSED:
            value = jnp.ravel(getattr(stream, name))
            if name in TOGETHER:
                size = jnp.broadcast_to(amount, value.shape)
            elif name == "numbers":
                size = jnp.broadcast_to(jnp.max(value, initial=0.0), value.shape)
            else:
                size = value
            results.append(jnp.where(size > 0, size, 1.0))
    return jnp.concatenate(results)
