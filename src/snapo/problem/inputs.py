"""Inputs: the numbers a user knows, with the name, unit and labels of a sensitivity table."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from .record import Input as Input
from .record import is_input as is_input
from .record import trees as trees  # inputs are trees of JAX from here on


class Frozen(eqx.Module):
    """A table that a policy holds and that training does not change."""

    array: Any

    def __jax_array__(self):
        return jax.lax.stop_gradient(self.array)


class NamedInput(NamedTuple):
    """An input and its name in tables, such as `forward_curve` or `factors.0.volatility`."""

    name: str
    input: Input


def plain(inputs: PyTree) -> PyTree:
    """The same module with plain arrays instead of every `Input`, as `prepare` receives it."""
    return jax.tree.map(lambda x: x.value if is_input(x) else x, inputs, is_leaf=is_input)


def unnamed(inputs: PyTree) -> PyTree:
    """The same module with inputs that have no labels and units, so that compiled code can be
    reused for inputs with other labels and units."""
    return jax.tree.map(lambda x: Input(x.value) if is_input(x) else x, inputs, is_leaf=is_input)


def named_inputs(inputs: PyTree) -> list[NamedInput]:
    """All inputs in tree order with their names."""
    result = jax.tree_util.tree_flatten_with_path(inputs, is_leaf=is_input)[0]
    return [NamedInput(name_of(path), leaf) for path, leaf in result if is_input(leaf)]


def values(inputs: PyTree) -> list[np.ndarray]:
    """The values of all inputs, in the order of `named_inputs`."""
    return [entry.input.value for entry in named_inputs(inputs)]


def replace(inputs: PyTree, new: Sequence[Any]) -> PyTree:
    """The plain module with `new` values instead of the inputs, in the order of `named_inputs`.

    Unlike `plain`, it takes traced values, so that `prepare` can be differentiated.
    """
    remaining = iter(new)
    return jax.tree.map(lambda x: next(remaining) if is_input(x) else x, inputs, is_leaf=is_input)


def name_of(path) -> str:
    """The name of the input at a path (as JAX defines it) in the tree of inputs."""
    parts = [
        getattr(key, "name", None) or str(getattr(key, "key", getattr(key, "idx", key)))
        for key in path
    ]
    return ".".join(parts) or "input"
