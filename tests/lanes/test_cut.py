"""Slices of arrays that were put together read the parts, with the same numbers."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from tests.lanes.in_numpy import in_numpy

from snapo.lanes.program.cut import evaluate, inlined

X = np.linspace(0.3, 2.9, 6, dtype=np.float32)


def primitives(function) -> list[str]:
    """Those that its outputs need, after slices have been replaced."""
    closed = jax.make_jaxpr(function)(X)
    closed = jax.make_jaxpr(lambda *values: evaluate(closed, values))(X)
    live, names = set(map(id, closed.jaxpr.outvars)), []
    for eqn in reversed(closed.jaxpr.eqns):
        if any(id(v) in live for v in eqn.outvars):
            live.update(map(id, eqn.invars))
            names.append(eqn.primitive.name)
    return sorted(names)


def test_numbers_that_nobody_reads_are_not_computed():
    def read(x):
        economics = jnp.stack([2 * x[0], x[1] + x[2]])
        features = [jnp.stack([jnp.tanh(x[3]), jnp.exp(x[4])]), jnp.atleast_1d(jnp.sin(x[5]))]
        observation = jnp.concatenate([economics, *features])
        head, tail = observation[:2], observation[2:]
        return head[0] * head[1] + tail[1]

    names = primitives(read)
    assert "exp" in names and not {"tanh", "sin", "concatenate", "stack"} & set(names)


def test_unpacking_reads_the_parts():
    def read(x):
        first, _ = jnp.concatenate([jnp.stack([2 * x[0], jnp.tanh(x[1])]), x])[:2]
        return first

    assert "tanh" not in primitives(read)


def test_no_derivative_goes_through_a_part_that_is_not_read():
    def read(x):
        return jnp.concatenate([x[:1] * x[1:2], jnp.log(x[2:])])[0]

    def simplified(x):
        return evaluate(jax.make_jaxpr(read)(x), [x])[0]

    x = jnp.array([2.0, 3.0, 0.0, -1.0])
    np.testing.assert_array_equal(jax.grad(simplified)(x), [3.0, 2.0, 0.0, 0.0])


@st.composite
def assemblies(draw):
    """A function that assembles arrays along an axis and slices them, maybe twice."""
    axis = draw(st.integers(0, 1))
    sizes = draw(st.lists(st.integers(1, 4), min_size=1, max_size=4))
    whole = sum(sizes)
    cuts = [sorted(draw(st.tuples(st.integers(0, whole), st.integers(0, whole)))) for _ in range(2)]
    stacked = draw(st.booleans())
    stride = draw(st.sampled_from([None, 1, 2]))

    def function(x):
        if stacked:
            array = jnp.stack([jnp.cos(x[i % 6]) + x for i in range(whole)])
        else:
            other = x[:3] if axis else x[3:]
            rows = [jnp.outer(x[:size], other) for size in sizes]
            array = jnp.concatenate([row.T if axis else row for row in rows], axis)
        along = 0 if stacked else axis
        results = []
        for first, last in cuts:
            part = jax.lax.slice_in_dim(array, first, last, axis=along)
            results.append(part)
            if last - first > 1:
                results.append(jax.lax.slice_in_dim(part, 1, last - first, stride or 1, along))
            if last > first:
                results.append(jnp.squeeze(jax.lax.slice_in_dim(part, 0, 1, axis=along), along))
        return results

    return function


@given(assemblies())
def test_every_slice_has_the_numbers_of_the_array(function):
    x = X.astype(np.float64)
    with jax.enable_x64(True):
        closed = jax.make_jaxpr(function)(x)
    expected, results = in_numpy(lambda x: (function(x), evaluate(closed, [x])))(x)
    for found, right in zip(results, expected, strict=True):
        np.testing.assert_array_equal(found, right)
        assert found.shape == right.shape


def test_plain_calls_know_what_their_caller_assembled():
    def read(x):
        whole = jnp.concatenate([x[:2], jnp.tanh(x[2:])])
        return jax.jit(lambda array: array[1] + 1)(whole)

    closed = inlined(read, [jax.ShapeDtypeStruct(X.shape, X.dtype)])
    live = {id(v) for v in closed.jaxpr.outvars}
    for eqn in reversed(closed.jaxpr.eqns):
        if any(id(v) in live for v in eqn.outvars):
            live.update(map(id, eqn.invars))
            assert eqn.primitive.name != "tanh"
