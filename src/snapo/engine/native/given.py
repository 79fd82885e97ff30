"""Trees that all paths share, taken apart, and the types of their arrays."""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree


class SharedTree:
    """A tree that all paths share, taken apart once per call, as flattening takes time.

    Arrays, as NumPy with floating ones in the call's precision, are read anew at every call;
    everything else is compiled in.
    """

    def __init__(self, tree, dtype):
        leaves, self.tree = jax.tree.flatten(tree)
        self.leaves = [cast(x, dtype) if _is_array(x) else x for x in leaves]

    @property
    def arrays(self) -> list[np.ndarray]:
        return [x for x in self.leaves if isinstance(x, np.ndarray)]

    def key(self, skip: int = 0) -> tuple:
        """All that a kernel depends on: structure, types, shapes, and all that is no array."""
        return self.tree, tuple(
            (x.shape[skip:], x.dtype) if isinstance(x, np.ndarray) else (type(x), x)
            for x in self.leaves
        )

    def split(self) -> tuple[PyTree, PyTree]:
        """The tree with its arrays only, and with all the rest only; None elsewhere."""
        arrays = [x if isinstance(x, np.ndarray) else None for x in self.leaves]
        rest = [None if isinstance(x, np.ndarray) else x for x in self.leaves]
        return jax.tree.unflatten(self.tree, arrays), jax.tree.unflatten(self.tree, rest)

    def like(self, values: Iterable) -> PyTree:
        """The tree with these in place of its arrays, in order, and None in place of the rest."""
        values = iter(values)
        filled = [next(values) if isinstance(x, np.ndarray) else None for x in self.leaves]
        return jax.tree.unflatten(self.tree, filled)


def _is_array(x) -> bool:
    return isinstance(x, np.ndarray | np.generic | jax.Array)


def cast(x, dtype) -> np.ndarray:
    """An array as NumPy, floating ones in this precision: nothing is compiled for it."""
    array = np.asarray(x)
    return array.astype(dtype, copy=False) if jnp.issubdtype(array.dtype, jnp.floating) else array


def jax_type(x) -> np.dtype:
    """The type that JAX gives this array under the present precision."""
    return np.dtype(jax.dtypes.canonicalize_dtype(x.dtype))


def floating(x) -> bool:
    """Whether an array holds floating numbers."""
    return bool(np.issubdtype(x.dtype, np.floating))
