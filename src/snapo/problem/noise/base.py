"""The protocol of noise: the values of one step as a function of standard normals.

Engines draw standard normals from a counter. A `Noise` turns some of them into a value by plain
`jax.numpy`, inside `step`, so that both engines trace the same function, and antithetic, Sobol and
supplied scenarios work for every distribution. Its parameters are leaves of a tree: numbers, or
`Input`s, which makes them differentiable:

    inputs = {"demand": snapo.noise.Poisson(snapo.Input(4.0, "units")),
              "price": snapo.noise.Student(df=snapo.Input(5.0))}

    def prepare(self, inputs):
        return snapo.Schedule({"noises": snapo.noise.prepare(inputs)}, …)

    def step(self, constants, now, state, action, noise, smooth):
        drawn = snapo.noise.draw(constants["noises"], noise)
        … drawn["demand"], drawn["price"]
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jax.scipy.special import ndtr
from jaxtyping import Array, Float, PyTree

from ..inputs import Input, is_input, name_of


class Noise(eqx.Module):
    """A distribution, as a function of `size` standard normals. Subclass it and write `draw`.

    **Attributes:**

    - `size`: the number of standard normals of one draw.
    - `separate`: whether draws are discrete (whole numbers, regimes), so that a small change of a
      parameter changes no path, or changes a few paths by a whole number: see `Simulator.in_mean`.

    Fields are its parameters: numbers, arrays, or `Input`s that `Simulator.prepare` receives as
    plain arrays. The derivative with respect to a parameter is that of `draw`: where a draw jumps,
    it is zero unless the class states otherwise.

    >>> import jax.numpy as jnp
    >>> class Logistic(snapo.Noise):
    ...     scale: float
    ...     def draw(self, normals):
    ...         u = snapo.noise.uniform(normals[0])
    ...         return self.scale * jnp.log(u / (1 - u))
    >>> float(Logistic(2.0).draw(np.zeros(1)))
    0.0
    """

    size: ClassVar[int] = 1
    separate: ClassVar[bool] = False

    def prepare(self) -> "Noise":
        """The same noise with all precomputations that paths share, for `Simulator.prepare`."""
        return self

    @abc.abstractmethod
    def draw(self, normals: Float[Array, " size"], *state: Any) -> Any:
        """The value at these normals; `state` is that of a noise with memory, such as `Markov`."""


def uniform(normal: Float[Array, "..."]) -> Float[Array, "..."]:
    """The uniform number u between 0 and 1 at a standard normal; at -normal it is 1 - u."""
    return ndtr(normal)


def size(noises: PyTree) -> int:
    """The number of standard normals that one draw of a `Noise`, or of a tree of them, takes.

    >>> snapo.noise.size({"demand": snapo.noise.Poisson(4.0), "price": snapo.noise.Student(5.0)})
    3
    """
    return sum(leaf.size for leaf in leaves(noises))


def prepare(noises: PyTree) -> PyTree:
    """All noises of a tree prepared, for `Simulator.prepare`; other leaves stay unchanged."""
    return jax.tree.map(
        lambda item: item.prepare() if _is_noise(item) else item, noises, is_leaf=_is_noise
    )


def draw(noises: PyTree, normals: Float[Array, " size"], **states: Any) -> PyTree:
    """The values of one step, shaped like the tree: a dictionary of noises gives a dictionary of
    values.

    `states` are the states of noises with memory, by name: `draw(noises, normals, regime=regime)`.
    The noises take the normals in the order of the tree; a dictionary has the order of its sorted
    keys.
    """
    result, structure = jax.tree_util.tree_flatten_with_path(noises, is_leaf=_is_noise)
    requested = size(noises)
    if normals.shape != (requested,):
        raise ValueError(
            f"noise: these noises take {requested} normals per step, but got {normals.shape}; "
            f"set noise_size = {requested}."
        )
    values, first = [], 0
    for path, item in result:
        if not _is_noise(item):
            raise TypeError(f"noise: {jax.tree_util.keystr(path)} is {item!r}, not a Noise.")
        name = getattr(path[0], "key", None) if path else None
        state = (states[name],) if name in states else ()
        values.append(item.draw(normals[first : first + item.size], *state))
        first += item.size
    return structure.unflatten(values)


def only(normals: Float[Array, " 1"]) -> Float[Array, ""]:
    """The normal of a noise that takes one, which may also be passed as a number."""
    return normals.reshape(-1)[0]


def numbers(value: Any) -> Any:
    """A parameter in stored form: lists become arrays, not trees of numbers."""
    return np.asarray(value, np.float64) if isinstance(value, list | tuple) else value


def parameter(**options: Any) -> Any:
    """The field of a parameter."""
    return eqx.field(converter=numbers, **options)


def concrete(value: Any) -> np.ndarray | None:
    """A parameter as numbers; None while JAX traces it."""
    value = value.value if isinstance(value, Input) else value
    return None if isinstance(value, Tracer) else np.asarray(value, np.float64)


def refuse(noise: Noise, name: str, low: float = 0.0, high: float = np.inf) -> None:
    """Refuses a parameter outside low < x < high, if it is known."""
    value = concrete(getattr(noise, name))
    if value is None or (np.all(value > low) and np.all(value < high)):
        return
    above = "" if high == np.inf else f" and below {high:g}"
    raise ValueError(
        f"{type(noise).__name__}: {name} is {value.tolist()}; it must be above {low:g}{above}."
    )


def in_mean(inputs: PyTree) -> tuple[str, ...]:
    """The names of the inputs (see `inputs.named_inputs`) that are parameters of separate draws."""

    def separate(item: Any) -> bool:
        return isinstance(item, Noise) and item.separate

    results = []
    for above, noise in jax.tree_util.tree_flatten_with_path(inputs, is_leaf=separate)[0]:
        if separate(noise):
            below = jax.tree_util.tree_flatten_with_path(noise, is_leaf=is_input)[0]
            results += [name_of((*above, *path)) for path, leaf in below if is_input(leaf)]
    return tuple(results)


def _is_noise(item: Any) -> bool:
    return isinstance(item, Noise)


def leaves(noises: PyTree) -> list[Noise]:
    return [leaf for leaf in jax.tree.leaves(noises, is_leaf=_is_noise) if _is_noise(leaf)]
