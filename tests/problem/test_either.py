"""Equations for both libraries: NumPy evaluates them as JAX does, and differentiates them too."""

import threading

import jax
import numpy as np
import pytest
import scipy.special

from snapo.problem.record import either
from snapo.problem.record.either import xp

MATRIX = np.array([[2.0, 0.0, 0.0], [0.5, 1.5, 0.0], [-0.3, 0.2, 0.8]])
VECTOR = np.array([0.3, -1.2, 2.5])


def _scanned(x):
    def step(state, row):
        total, _ = state
        total = total * row[0] + row[1][0]
        return (total, None), (total, [None, 2 * total])

    last, rows = either.scan(step, (x[0], None), (x, [x**2, None]), len(x))
    return xp.append(rows[1][1], last[0] + rows[0][-1])


# Functions of a vector, analytic about `VECTOR`.
FUNCTIONS = {
    "elementary": lambda x: xp.exp(x) + xp.expm1(x) * xp.log1p(x**2) + xp.sinh(x) / xp.sqrt(9 + x),
    "absolute": lambda x: xp.abs(x) * x,
    "chosen": lambda x: xp.where(x > 0, x**2, 3 * x) + xp.maximum(x, 1.0),
    "error function": lambda x: either.erf(x / 2),
    "updated": lambda x: either.updated(x**2, np.array([2, 0]), x[:2]),
    "added": lambda x: either.added(x**2, np.array([1, 1, 0]), x),
    "scanned": _scanned,
    "repeated": lambda x: either.repeated(3, lambda i, state: state * x + i, x),
    "over": lambda x: either.over(lambda entry: xp.stack([entry, entry**3]))(x).ravel(),
    "solved": lambda x: xp.linalg.solve(MATRIX + 0.1 * xp.diag(x), x),
    "lower": lambda x: either.solve_lower(MATRIX + 0.1 * xp.diag(x), x),
    "sums": lambda x: xp.cumsum(xp.concatenate([x, xp.diff(x)])) @ xp.arange(5.0) * x,
    "mapped": lambda x: either.tree_map(lambda a, b: a * b, [x, None], [x, None])[0],
    "inner slope": lambda x: x * either.derivative(lambda y: xp.exp(2 * y))(xp.asarray(0.3)),
}


@pytest.fixture(autouse=True)
def wide():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numpy_evaluates_and_differentiates_as_jax_does(name):
    function = FUNCTIONS[name]
    value = either.with_numpy(function)(VECTOR)
    assert isinstance(value, np.ndarray) and value.dtype == np.float64
    found, exact = jax.jit(lambda x: (function(x), jax.jacfwd(function)(x)))(VECTOR)
    np.testing.assert_allclose(value, found, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(either.jacobian(function, VECTOR), exact, rtol=1e-13, atol=1e-14)


def test_slopes_are_those_of_closed_forms():
    for x in (1e-8, 0.7, 30.0):
        assert either.slope(lambda x: xp.exp(-x) * xp.log1p(x), x) == pytest.approx(
            np.exp(-x) * (1 / (1 + x) - np.log1p(x)), rel=1e-14
        )
    assert either.slope(either.erf, 0.4) == pytest.approx(
        2 / np.sqrt(np.pi) * np.exp(-0.16), rel=1e-14
    )
    assert either.with_numpy(either.erf)(0.4) == scipy.special.erf(0.4)


def test_a_fixed_number_has_no_derivative():
    function = lambda x: either.fixed(x**2) * x  # noqa: E731
    assert either.slope(function, 3.0) == jax.grad(function)(3.0) == 9.0


@pytest.mark.parametrize("evaluated", [either.with_numpy, jax.jit])
def test_matrices_without_a_result_give_nan(evaluated):
    solution = evaluated(lambda: xp.linalg.solve(xp.zeros((2, 2)), xp.ones(2)))()
    root = evaluated(lambda: xp.linalg.cholesky(-xp.eye(2)))()
    assert not np.isfinite(solution).any() and np.isnan(np.diag(root)).all()


def test_numpy_is_in_use_within_the_function_only():
    seen = []

    def fails():
        thread = threading.Thread(target=lambda: seen.append(either.in_use()))
        thread.start()
        thread.join()
        seen.append(either.in_use())
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        either.with_numpy(fails)()
    assert [*seen, either.in_use()] == [False, True, False]
    assert isinstance(xp.zeros(2), jax.Array)


@pytest.mark.parametrize("evaluated", [either.with_numpy, jax.jit])
def test_rows_are_gone_through_backwards(evaluated):
    """x_t = a_t x_(t+1) + b_t from x_T = 2, and the running maximum of it; c as it is."""
    a, b = np.array([0.5, -2.0, 0.25]), np.array([1.0, 3.0, -1.0])

    def rolled():
        def step(later, row):
            return row[0] * later[0] + row[1][0], row[1][1]

        rows = a, (b, None)
        return either.backwards(step, (xp.asarray(2.0), None), rows, len(a))

    x, none = evaluated(rolled)()
    assert np.asarray(x).tolist() == [3.0, 4.0, -0.5] and none is None
    assert np.asarray(evaluated(either.running_maximum)(x)).tolist() == [3.0, 4.0, 4.0]


def test_known_numbers_are_evaluated_within_a_trace():
    def function(x):
        return x + float(either.at_once(xp.exp)(0.5))

    assert jax.jit(function)(1.0) == 1 + np.exp(0.5) == either.with_numpy(function)(1.0)
