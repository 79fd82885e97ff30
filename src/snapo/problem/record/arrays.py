"""JAX for modules that describe a kind of case and state its equations: loaded at its first use.

    from snapo.problem.record.arrays import Array, Float, jnp

A price process, a unit operation or a contract is one file with the keys of its table and its
equations. Reading a case needs the table, but evaluates no equations. The names are those of the
libraries, and so are the objects that come from them: `jnp.exp` is `jax.numpy.exp`. Types of arrays
are those of jaxtyping for type checkers, and empty at run time.

Equations that a check evaluates too use `xp` of `either`: JAX in a simulator, NumPy in a check.
"""

from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    import equinox as eqx
    import jax
    import jax.flatten_util
    import jax.numpy as jnp
    from jax.typing import ArrayLike
    from jaxtyping import Array, Bool, Float, Int, PyTree
else:

    class _Library(ModuleType):
        """A library that is imported when one of its names is first used; it stores its names."""

        def __getattr__(self, name: str):
            if name.startswith("__"):
                raise AttributeError(name)
            import_module(f"{__package__}.trees")  # records are trees from here on
            library = import_module(self.__name__)
            if not hasattr(library, name):
                import_module(f"{self.__name__}.{name}")
            value = getattr(library, name)
            setattr(self, name, value)
            return value

    class Array:
        """An array, or a tree of arrays; its type and shape are only for readers."""

        def __class_getitem__(cls, shape):
            return cls

    eqx, jax, jnp = map(_Library, ("equinox", "jax", "jax.numpy"))
    ArrayLike = Bool = Float = Int = PyTree = Array

P = ParamSpec("P")
NumbersOf = Callable[[Any], Any]  # the numbers of an input where they are used
R = TypeVar("R")


def custom_jvp(
    tangent: Callable[..., Any], fixed: tuple[int, ...] = ()
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Gives a function the rule `tangent` of its derivatives: `jax.custom_jvp`, made when the
    function is first called. `fixed`: positions of arguments without derivatives."""

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        @cache
        def made() -> Callable[P, R]:
            result = jax.custom_jvp(function, nondiff_argnums=fixed)
            result.defjvp(tangent)
            return result

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            return made()(*args, **kwargs)

        return call

    return decorated
