"""Converts sets of actions to Gymnasium's spaces, and elements of one to elements of the other.

Elements of a space are in groups of N, as in vectorised environments: an array [N, …], or for a
`Dict` one array for each name.
"""

from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from snapo.problem.actions import Actions, Box, Choice, Integers, Product, Simplex, Stop

try:
    import gymnasium
except ImportError as error:
    raise ImportError(
        "snapo.gym needs Gymnasium, which is not installed: pip install 'snapo[gym]'."
    ) from error

Space = Any  # of Gymnasium, which has no common type for them
Elements = Any  # N of a space
SpaceReader = Callable[[Elements], np.ndarray]  # to [N, size] of the set
Writer = Callable[[np.ndarray], Elements]  # and back


def space_of(action: Actions) -> tuple[Space, SpaceReader]:
    """The space for a set of actions, and the function from elements of the space to the exact set.
    The space of a `Choice` is `Discrete`, and the space of a `Product` is a `Dict` of its sets by
    name. For a `Simplex` any numbers from 0 to 1 are normalised; whole numbers are rounded; bounds
    are enforced by clipping.

    **Raises:** `ValueError` for a set that has no space.
    """
    if isinstance(action, Product):
        parts = {name: space_of(action[name]) for name in action.names}
        space = gymnasium.spaces.Dict({name: part for name, (part, _) in parts.items()})

        def read_all(values: Elements) -> np.ndarray:
            return np.concatenate([read(values[name]) for name, (_, read) in parts.items()], -1)

        return space, read_all
    if isinstance(action, Choice):
        return gymnasium.spaces.Discrete(action.size), lambda n: np.eye(action.size)[np.asarray(n)]
    if not isinstance(action, Box | Integers | Stop | Simplex):
        raise ValueError(
            f"Environment: a {type(action).__name__} has no corresponding Gymnasium space."
        )
    low, high = (np.asarray(bound, np.float32) for bound in action.bounds())
    space = gymnasium.spaces.Box(low, high, dtype=np.float32)

    def read(inputs: np.ndarray) -> np.ndarray:
        inside = np.clip(np.asarray(inputs, np.float32).reshape(-1, action.size), low, high)
        if isinstance(action, Simplex):
            total = inside.sum(-1, keepdims=True)
            return np.where(total > 0, inside / np.maximum(total, 1e-30), 1 / action.size)
        return inside if isinstance(action, Box) else np.round(inside)

    return space, read


def writer(space: Space, action: Actions | None = None) -> Writer:
    """The function from decisions [N, size] of the exact set to N elements of the space.

    - `Discrete` takes the best option of a `Choice`, or one whole number, which counts from the
      `start` of the space; `MultiDiscrete` and `MultiBinary` take whole numbers.
    - `Dict` takes a `Product` whose sets have its names; a `Box` the numbers unchanged.
    - `action`: the set, if known; otherwise the number of decisions is used.

    **Raises:** `ValueError` if the set and the space have nothing in common.
    """
    spaces = gymnasium.spaces
    if isinstance(space, spaces.Dict):
        if not isinstance(action, Product) or set(action.names) != set(space.keys()):
            _refuse(space, action)
        parts = {name: writer(space[name], action[name]) for name in action.names}
        return lambda decided: {
            name: parts[name](part) for name, part in action.parts(decided).items()
        }
    if isinstance(space, spaces.Discrete):
        options = int(space.n)
        if action is not None and not isinstance(action, Choice) and action.size > 1:
            _refuse(space, action)
        if isinstance(action, Choice) and action.size != options:
            _refuse(space, action)
        return lambda decided: space.start + _option(decided, options)
    counts = isinstance(space, spaces.MultiDiscrete | spaces.MultiBinary)
    if not counts and not isinstance(space, spaces.Box):
        _refuse(space, action)
    shape = tuple(space.shape)
    if action is not None and action.size != int(np.prod(shape)):
        _refuse(space, action)
    start = getattr(space, "start", 0) if counts else 0

    def write(decided: np.ndarray) -> np.ndarray:
        numbers = np.round(decided) if counts else decided
        return numbers.astype(space.dtype).reshape(len(decided), *shape) + np.asarray(
            start, space.dtype
        )

    return write


def batched(element: Any) -> Elements:
    """One element as a group of N = 1."""
    if isinstance(element, dict):
        return {name: batched(part) for name, part in element.items()}
    return np.asarray(element)[None]


def element(elements: Elements, i: int) -> Any:
    """The element `i` of a group of N."""
    if isinstance(elements, dict):
        return {name: element(part, i) for name, part in elements.items()}
    return elements[i]


def _option(decided: np.ndarray, options: int) -> np.ndarray:
    """[N] numbers of options, from the weights [N, options] of all options or from the numbers [N,
    1]."""
    size = decided.shape[-1]
    if size == 1:
        return np.round(decided[:, 0]).astype(np.int64)
    if size != options:
        raise ValueError(
            f"Agent: the policy decides {size} numbers, but there are {options} options."
        )
    return np.argmax(decided, -1)


def _refuse(space: Space, action: Actions | None) -> NoReturn:
    raise ValueError(
        f"Agent: decisions in {action} do not fit into the space {space}; pass "
        "snapo.gym.Agent(policy, action=…) a function from decisions [N, size] to elements of "
        "the space."
    )
