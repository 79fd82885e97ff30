"""Equations for both libraries: `xp` is `jax.numpy`, and NumPy within a function `with_numpy`.

A simulator is traced by JAX. A check evaluates the same equations once, for which NumPy avoids the
import of JAX. If the two libraries differ, the functions here are one name for both.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial, wraps
from importlib import import_module
from operator import itemgetter
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from .arrays import jax, jnp

P = ParamSpec("P")
R = TypeVar("R")

_LIBRARY: ContextVar[Any] = ContextVar("_LIBRARY", default=jnp)
STEP = 2.0**-100  # of a complex step: numbers do not change by its square


def in_use() -> bool:
    """Whether equations are evaluated by NumPy now."""
    return _LIBRARY.get() is _NUMPY


@contextmanager
def _numpy() -> Iterator[None]:
    before = _LIBRARY.set(_NUMPY)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        _LIBRARY.reset(before)


def with_numpy(function: Callable[P, Any]) -> Callable[P, Any]:
    """`function` for NumPy arrays, with its equations evaluated by NumPy in float64."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> Any:
        with _numpy():
            return function(*args, **kwargs)

    return call


def at_once(function: Callable[P, R]) -> Callable[P, R]:
    """`function` of concrete numbers, evaluated in float64 even while JAX traces."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if in_use():
            return function(*args, **kwargs)
        with jax.enable_x64(True), jax.ensure_compile_time_eval():
            return function(*args, **kwargs)

    return call


def slope(function: Callable[[Any], Any], x: Any) -> np.ndarray:
    """d `function` / d `x` at a number, by NumPy: exact except for rounding, without differences.

    `function` must be analytic at this number; its result may have any shape. The method is the
    complex step: W. Squire, G. Trapp, SIAM Review 40, 1998.
    """
    return np.imag(with_numpy(function)(x + 1j * STEP)) / STEP


def jacobian(function: Callable[[Any], Any], x: np.ndarray) -> np.ndarray:
    """[..., n] d `function` / d an entry of the vector `x` [n], by `slope`."""

    def along(unit: np.ndarray) -> np.ndarray:
        return slope(lambda shift: function(x + shift * unit), 0.0)

    return np.stack([along(unit) for unit in np.eye(len(x))], axis=-1)


def fixed(x: Any) -> Any:
    """A number without a derivative."""
    return np.real(x) if in_use() else jax.lax.stop_gradient(x)


def updated(x: Any, index: Any, values: Any) -> Any:
    """`x` with `values` at an index."""
    if not in_use():
        return x.at[index].set(values)
    result = np.array(x, np.result_type(x, values))
    result[index] = values
    return result


def added(x: Any, index: Any, values: Any) -> Any:
    """`x` with `values` added at an index; repeated indices add up."""
    if not in_use():
        return x.at[index].add(values)
    result = np.array(x, np.result_type(x, values))
    np.add.at(result, index, values)
    return result


def tree_map(function: Callable[..., Any], tree: Any, *more: Any) -> Any:
    """`jax.tree.map`; with NumPy only for tuples, lists and None."""
    if not in_use():
        return jax.tree.map(function, tree, *more)
    if tree is None:
        return None
    if not isinstance(tree, tuple | list):
        return function(tree, *more)
    made = getattr(type(tree), "_make", type(tree))
    return made([tree_map(function, *parts) for parts in zip(tree, *more)])


def scan(
    step: Callable[[Any, Any], tuple[Any, Any]], start: Any, rows: Any, count: int, reverse=False
) -> Any:
    """`jax.lax.scan` over `count` rows: the final state, and the stacked results."""
    if not in_use():
        return jax.lax.scan(step, start, rows, count, reverse)
    results: list[Any] = [None] * count
    for t in reversed(range(count)) if reverse else range(count):
        start, results[t] = step(start, tree_map(itemgetter(t), rows))
    return start, tree_map(lambda *leaves: np.stack(leaves), *results)


def backwards(step: Callable[[Any, Any], Any], last: Any, rows: Any, count: int) -> Any:
    """Stacked results of `step(result of the next row, row)`, backwards from `last`."""

    def both(following: Any, row: Any) -> tuple[Any, Any]:
        result = step(following, row)
        return result, result

    return scan(both, last, rows, count, reverse=True)[1]


def running_maximum(x: Any) -> Any:
    """[n] the maximum of the elements up to each of `x` [n]."""
    return np.maximum.accumulate(x) if in_use() else jax.lax.cummax(x)


def over(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """`function` of a number, applied to every entry of a vector."""
    if not in_use():
        return jax.vmap(function)
    return lambda x: np.stack([function(entry) for entry in x])


def repeated(count: int, step: Callable[[Any, Any], Any], start: Any) -> Any:
    """`jax.lax.fori_loop` from 0: the state after `count` steps of `step(i, state)`."""
    if not in_use():
        return jax.lax.fori_loop(0, count, step, start)
    for i in range(count):
        start = step(i, start)
    return start


def derivative(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The derivative of a number with respect to a number."""
    return partial(slope, function) if in_use() else jax.grad(function)


def erf(x: Any) -> Any:
    """The error function."""
    return import_module("scipy.special" if in_use() else "jax.scipy.special").erf(x)


def solve_lower(matrix: Any, right: Any) -> Any:
    """The vector x with `matrix` x = `right`, for a lower triangular matrix."""
    if not in_use():
        return jax.scipy.linalg.solve_triangular(matrix, right, lower=True)
    result = np.zeros_like(right)
    for i, row in enumerate(matrix):
        result[i] = (right[i] - row[:i] @ result[:i]) / row[i]
    return result


def _or_nan(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with NaNs, as in JAX, if a matrix has no such result."""

    def call(*arrays: Any) -> Any:
        try:
            return function(*arrays)
        except np.linalg.LinAlgError:
            return np.full_like(arrays[-1], np.nan)

    return call


def _absolute(x: Any) -> Any:
    """The absolute value by the sign of the real part: a complex number is a real one that is
    moved."""
    return np.where(np.real(x) < 0, -x, x) if np.iscomplexobj(x) else np.abs(x)


class _Numpy(SimpleNamespace):
    """NumPy, except for functions that differ; requested names are stored."""

    abs = staticmethod(_absolute)
    linalg = SimpleNamespace(solve=_or_nan(np.linalg.solve), cholesky=_or_nan(np.linalg.cholesky))

    def __getattr__(self, name: str) -> Any:
        value = getattr(np, name)
        setattr(self, name, value)
        return value


_NUMPY = _Numpy()

if TYPE_CHECKING:
    import jax.numpy as xp
else:

    class _Either(ModuleType):
        def __getattribute__(self, name: str):
            return getattr(_LIBRARY.get(), name)

    xp = _Either("xp")
