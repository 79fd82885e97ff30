"""The form of a case: everything on which compiled code depends. Its numbers are arguments of that
code.

A simulator of a domain contains no case, but modules with fields of two kinds: static ones (kinds,
rules, names, sizes, flags), which JAX compares, and arrays. Traced code cannot read anything else:
two cases with equal `form_of` are the same program, and the second one compiles nothing.
"""

from collections.abc import Hashable, Mapping
from typing import Any, TypeVar

import numpy as np

from .record import TreeRecord, field
from .record.arrays import Array, Float, Int, PyTree, jax, jnp

T = TypeVar("T")


class Use(TreeRecord):
    """The use of an input's numbers.

    - `name`: the name of the input; `size`: its number of entries.
    - `shape`: the shape of the numbers where they are used.
    - `index`: integers of that shape, the positions in the input's numbers; None if the numbers
      are used one by one in order, if one number is used everywhere, or if there is no number.
    """

    name: str = field(static=True)
    size: int = field(static=True)
    shape: tuple[int, ...] = field(static=True)
    index: Int[np.ndarray, "..."] | None = None

    @classmethod
    def of(cls, name: str, size: int, index: Int[np.ndarray, "..."]) -> "Use":
        """The use of the input `name` with this number of entries, used at `index`."""
        plain = size <= 1 or np.array_equal(index, np.arange(size))
        return cls(name, size, index.shape, None if plain else index)

    def __call__(self, inputs: dict[str, Any]) -> Float[Array, "..."]:
        """The numbers where they are used; zeros where the input has none."""
        if self.size == 0:
            return jnp.zeros(self.shape)
        numbers = jnp.asarray(inputs[self.name])
        # Most numbers hold on all days, and most curves have one for each day: nothing to gather.
        if self.size == 1:
            return jnp.broadcast_to(numbers.reshape(()), self.shape)
        if self.index is None:
            return numbers
        return numbers.at[self.index].get(mode="promise_in_bounds")

    def in_numpy(self, values: Mapping[str, np.ndarray]) -> Float[np.ndarray, "..."]:
        """The numbers where they are used, in NumPy."""
        if self.size <= 1:
            number = np.reshape(values[self.name], ()) if self.size else 0.0
            return np.broadcast_to(number, self.shape)
        return values[self.name] if self.index is None else values[self.name][self.index]


def is_array(x: Any) -> bool:
    return isinstance(x, np.ndarray | np.generic | jax.Array)


def formed(record: T) -> T:
    """A module of a case as a simulator stores it: arrays, and the `Use` of each input.

    A leaf with a method `use` is replaced by its result.

    **Raises:** `TypeError` for anything else, which would be a constant of the program.
    """

    def without_numbers(leaf: Any) -> Any:
        if is_array(leaf):
            return leaf
        if not hasattr(leaf, "use"):
            raise TypeError(
                f"{type(record).__name__}: {leaf!r} is neither an array nor a static field."
            )
        return leaf.use()

    return jax.tree.map(without_numbers, record)


def without_uses(tree: PyTree) -> PyTree:
    """The tree without its `Use`s, whose shapes often depend on dates: steps read none of them."""

    def uses(leaf: Any) -> bool:
        return isinstance(leaf, Use)

    return jax.tree.map(lambda leaf: None if uses(leaf) else leaf, tree, is_leaf=uses)


def form_of(tree: PyTree) -> Hashable:
    """All that code compiled for a tree depends on: its structure with all static fields, and the
    shapes and types of its arrays."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple(
        (leaf.shape, str(leaf.dtype)) if is_array(leaf) else leaf for leaf in leaves
    )
