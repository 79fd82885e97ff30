"""Functions of JAX evaluated by NumPy: the numbers of XLA, to rounding."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import erf, gammaln, ndtr
from tests.lanes.in_numpy import in_numpy

RANDOM = np.random.default_rng(0)
X, Y = RANDOM.normal(size=(4, 3)), RANDOM.normal(size=(4, 3))
PICK = np.array([2, 0, 3, 2])


def elementary(x, y):
    """Functions of single numbers."""
    positive = jnp.abs(x) + 0.1
    return [
        jnp.exp(x) + jnp.expm1(x) + jnp.exp2(y), jnp.log(positive) - jnp.log1p(positive),
        jnp.sqrt(positive) * jax.lax.rsqrt(positive) / y, jnp.tanh(x) + jnp.arctan2(x, y),
        jnp.maximum(x, y) - jnp.minimum(x, 0.1), jnp.where(x > y, x, y**2), positive**y, x**3,
        erf(x) + ndtr(y), gammaln(positive), jax.nn.sigmoid(x), jnp.clip(x, -0.5, 0.5),
        jnp.floor(x) + jnp.ceil(y) + jnp.round(10 * x), jnp.sign(x) * jnp.isfinite(1 / (y - y)),
        jnp.arange(3) // 2 - jnp.arange(3) % 2,
    ]  # fmt: skip


def shaped(x, y):
    """Sums, products, and rearranged arrays."""
    return [
        x @ y.T, jnp.einsum("ij,ik->ijk", x, y), jnp.einsum("ij,ij->", x, y), x.sum(0) / y.max(1)[0],
        jnp.cumsum(x, 1), jax.lax.cumsum(x, 0, reverse=True), jnp.cumprod(y, 0), x.prod(),
        jnp.argmax(x, 0), jnp.argmin(y, 1), jnp.any(x > 1, 0), jnp.all(x > -9), jnp.sort(x, 0),
        jnp.concatenate([x, y], 1), jnp.stack([x, y], 2), jnp.pad(x, ((1, 0), (0, 2))), x[:, ::-1],
        jnp.tile(x, 2), *jnp.split(x, 2), jnp.diff(y, axis=0), jnp.tril(x[:3]), jnp.roll(x, 1),
        jax.lax.pad(x, 0.0, ((-1, 0, 1), (0, -1, 0))), x.reshape(2, 6).T, jnp.eye(3)[None],
    ]  # fmt: skip


def indexed(x, y):
    """Numbers read and written by position, also outside of the array."""
    far = PICK + jnp.asarray(2, int)
    return [
        x[PICK], x[PICK, 1:], x[PICK[:, None], PICK[:3] % 3], x.at[far].get(mode="fill"),
        x.at[far].get(mode="clip"), jnp.take_along_axis(x, jnp.argsort(y, 1), 1),
        x.at[PICK].add(y), x.at[far, 1].set(7.0), x.at[1:3].set(0.0), x.at[far].add(y, mode="clip"),
        jax.vmap(lambda row, i: row[i])(x, PICK % 3),
        jax.vmap(lambda row, i: row.at[i].add(1.0))(x, PICK % 3),
        jax.lax.dynamic_slice(x, (PICK[2], 0), (2, 2)), jnp.interp(y, np.arange(3.0), x[0]),
        jax.lax.dynamic_update_slice(x, y[:2], (PICK[2], 0)), jnp.searchsorted(x[:, 0], y[:, 1]),
        jnp.arange(4).at[far].get(mode="fill"),
    ]  # fmt: skip


def controlled(x, y):
    """Loops, branches, matrices, and derivatives of all of them."""

    def total(x):
        first, rows = jax.lax.scan(lambda c, row: (c * 0.9 + row, c * row), x[0], x, reverse=True)
        square = x.T @ x + jnp.eye(3)
        lower = jnp.linalg.cholesky(square)
        solved = jax.scipy.linalg.solve_triangular(lower, y[0], lower=True)
        branch = jax.lax.cond(x[0, 0] > 0, jnp.sin, jnp.cos, x[0])
        return first.sum() + (rows**2).sum() + solved.sum() + branch @ x[PICK[1]]

    grown = jax.lax.while_loop(lambda c: c[0].sum() < 50, lambda c: (2 * c[0], c[1] + 1), (x**2, 0))
    again = jax.jit(jax.checkpoint(lambda x: jnp.log1p(x**2)))(x)
    return [total(x), jax.grad(total)(x), grown, again, jnp.linalg.solve(x[:3] + 3, y[:3])]


@pytest.mark.prove
@pytest.mark.parametrize("function", [elementary, shaped, indexed, controlled])
def test_the_results_are_those_of_the_compiler(function):
    evaluated = jax.tree.leaves(in_numpy(function)(X, Y))
    with jax.enable_x64(True):
        compiled = jax.tree.leaves(jax.jit(function)(X, Y))
    for result, exact in zip(evaluated, compiled, strict=True):
        assert isinstance(result, np.ndarray)
        assert (result.shape, result.dtype) == (exact.shape, exact.dtype)
        np.testing.assert_allclose(result, exact, rtol=1e-12, atol=1e-13)


def test_trees_are_traced_once_for_each_form():
    traced = []

    @in_numpy
    def scaled(numbers, factor=2.0):
        traced.append(1)
        return {name: factor * number for name, number in numbers.items()}

    for first in (1.0, 3.0):
        result = scaled({"a": first, "b": np.ones(2, np.float32)})
        assert result["a"] == 2 * first and result["b"].dtype == np.float64
    assert len(traced) == 1
    assert list(scaled({"a": 1.0}, factor=5.0)) == ["a"] and len(traced) == 2


def test_a_discounted_sum_and_its_gradient():
    """sum of d^t x_t is (1 - d^4) / (1 - d) at ones, and d^t its derivatives; by a loop, from the
    end."""

    def total(x):
        return jax.lax.scan(lambda later, now: (now + 0.9 * later, None), 0.0, x, reverse=True)[0]

    value, slopes = in_numpy(jax.value_and_grad(total))(np.ones(4))
    assert value == pytest.approx((1 - 0.9**4) / (1 - 0.9), rel=1e-14)
    np.testing.assert_allclose(slopes, 0.9 ** np.arange(4), rtol=1e-14)


def test_positions_outside_of_an_array():
    """Written numbers are dropped there, read ones missing, as of `jax.numpy`'s `at`."""
    far = np.array([1, 5])
    written = in_numpy(lambda x: x.at[far].add(1.0))(np.zeros(3))
    read = in_numpy(lambda x: x.at[far].get(mode="fill"))(np.arange(3.0))
    assert written.tolist() == [0.0, 1.0, 0.0] and read[0] == 1.0 and np.isnan(read[1])
