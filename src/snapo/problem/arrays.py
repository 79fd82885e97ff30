"""JAX for modules that describe a kind of case and state its equations: loaded at its first use.

    from snapo.problem.arrays import Array, Float, jnp

A price process, a unit operation or a contract is one file with the keys of its table and its
equations. Reading a case needs the first, and calls none of the second. The names are those of the
libraries, and so are the objects that come from them: `jnp.exp` is `jax.numpy.exp`. Types of arrays
are those of jaxtyping where types are checked, and nothing at run time.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import jax
    import jax.numpy as jnp
    from jaxtyping import Array, Bool, Float, Int, PyTree
else:

    class _Library(ModuleType):
        """A library that is imported when one of its names is first asked for, and keeps them."""

        def __getattr__(self, name: str):
            if name.startswith("__"):
                raise AttributeError(name)
            import_module(f"{__package__}.trees")  # records are trees from here on
            value = getattr(import_module(self.__name__), name)
            setattr(self, name, value)
            return value

    class Array:
        """An array, or a tree of arrays, of a type and a shape that are for readers."""

        def __class_getitem__(cls, shape):
            return cls

    jax, jnp = _Library("jax"), _Library("jax.numpy")
    Bool = Float = Int = PyTree = Array

__all__ = ["Array", "Bool", "Float", "Int", "PyTree", "jax", "jnp"]
