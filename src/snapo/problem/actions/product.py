"""Several decisions in one step."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .sets import Actions


def contains(action: Actions, kind: type[Actions]) -> bool:
    """Whether the set of a decision, or one of the sets in a `Product`, is of this kind.

    >>> contains(snapo.Product(stop=snapo.Stop(), size=snapo.Box(0.0, 1.0)), snapo.Stop)
    True
    """
    if isinstance(action, Product):
        return any(contains(item, kind) for item in action.sets)
    return isinstance(action, kind)


def decision_names(action: Actions) -> list[str]:
    """The names of all decisions, one per group of `together`; empty names outside a `Product`.

    >>> decision_names(snapo.Product(run=snapo.Choice(2), power=snapo.Box(0.0, 1.0, size=2)))
    ['run', 'power[0]', 'power[1]']
    """
    if not isinstance(action, Product):
        return [""] * len(action.together())
    return [
        f"{name}.{part}" if part else name if len(inner) == 1 else f"{name}[{i}]"
        for name, inner in zip(action.names, map(decision_names, action.sets))
        for i, part in enumerate(inner)
    ]


class Product(Actions):
    """Several decisions at once, by name: `Product(run=Choice(2), power=Box(0.0, 1.0))`.

    The action is the concatenation of all parts; `parts` returns them by name, and
    `self.action["run"]` is the set of one of them.

        decided = self.action.parts(action)
        power = decided["run"][1] * decided["power"][0]

    >>> both = snapo.Product(run=snapo.Choice(2), power=snapo.Box(0.0, 1.0))
    >>> both.size
    3
    >>> both.parts(np.array([0.0, 1.0, 0.4]))
    {'run': array([0., 1.]), 'power': array([0.4])}
    """

    names: tuple[str, ...] = eqx.field(static=True)
    sets: tuple[Actions, ...] = eqx.field(static=True)

    def __init__(self, **sets: Actions):
        if not sets:
            raise ValueError("Product: it has no sets; specify at least one, by name.")
        for name, item in sets.items():
            if not isinstance(item, Actions):
                raise ValueError(f"Product: {name} is {item!r}; it must be a set of actions.")
        self.names, self.sets = tuple(sets), tuple(sets.values())

    @property
    def size(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return sum(item.size for item in self.sets)

    def __getitem__(self, name: str) -> Any:
        return self.sets[self.names.index(name)]

    def parts(self, action: Any) -> dict[str, Any]:
        """{name: [… part]} of an action [… size]: the numbers of every decision."""
        endpoints = np.cumsum([item.size for item in self.sets]).tolist()
        return {
            name: action[..., end - entry.size : end]
            for name, entry, end in zip(self.names, self.sets, endpoints)
        }

    def squash(self, raw: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        """Maps each part into its set."""
        return self._each(lambda item, part: item.squash(part, smooth), raw)

    def near(self, base: Array, correction: Array, smooth) -> Float[Array, " size"]:
        """Adds a correction to the base of each part, within its set."""
        return self._each(lambda item, *values: item.near(*values, smooth), base, correction)

    def settle(self, action: Float[Array, " size"], smooth) -> Float[Array, " size"]:
        return self._each(lambda item, part: item.settle(part, smooth), action)

    @property
    def exploration_size(self) -> int:
        return sum(item.exploration_size for item in self.sets)

    def explore(self, action: Array, normals: Array, share: Array) -> Float[Array, " size"]:
        """Explores each part in its set, with separate normals."""
        explores, first, parts = [], 0, self.parts(action)
        for name, item in zip(self.names, self.sets):
            local = normals[first : first + item.exploration_size]
            explores.append(item.explore(parts[name], local, share))
            first += item.exploration_size
        return jnp.concatenate(explores)

    def fault(self, action: np.ndarray) -> tuple[str, str] | None:
        for name, part in self.parts(action).items():
            if fault := self[name].fault(part):
                return f"{name}: {fault[0]}", fault[1]
        return None

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = zip(*(item.bounds() for item in self.sets))
        return np.concatenate(low), np.concatenate(high)

    def together(self) -> list[list[int]]:
        results, first = [], 0
        for item in self.sets:
            results += [[first + i for i in group] for group in item.together()]
            first += item.size
        return results

    def _each(self, work: Callable[..., Array], *values: Array) -> Array:
        # A base may be one number for all components.
        full = [jnp.broadcast_to(jnp.asarray(x), (self.size,)) for x in values]
        parts = [self.parts(x) for x in full]
        return jnp.concatenate([work(self[n], *(p[n] for p in parts)) for n in self.names])
