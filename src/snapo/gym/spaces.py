"""Sets of actions as Gymnasium's spaces, and the way back."""

from collections.abc import Callable
from typing import Any

import numpy as np

from snapo.problem.actions import Actions, Box, Choice, Simplex, Stop, Whole

from .installed import gymnasium

Space = Any  # of Gymnasium, which has no types of its own for all of them
Reader = Callable[[np.ndarray], np.ndarray]  # from [N, …] of the space to [N, size] of the set


def space_of(action: Actions) -> tuple[Space, Reader]:
    """The space of a set of actions, and the function from its elements to the exact set.

    A `Choice` is `Discrete`, of a `Simplex` any numbers from 0 to 1 are taken in proportion, whole
    numbers are rounded; bounds are kept by clipping.

    **Raises:** `ValueError` for a set that has no space.
    """
    if isinstance(action, Choice):
        return gymnasium.spaces.Discrete(action.size), lambda n: np.eye(action.size)[n]
    if not isinstance(action, Box | Whole | Stop | Simplex):
        raise ValueError(f"Environment: a {type(action).__name__} has no space of Gymnasium.")
    low, high = (np.asarray(bound, np.float32) for bound in action.bounds())
    space = gymnasium.spaces.Box(low, high, dtype=np.float32)

    def read(given: np.ndarray) -> np.ndarray:
        inside = np.clip(np.asarray(given, np.float32).reshape(-1, action.size), low, high)
        if isinstance(action, Simplex):
            total = inside.sum(-1, keepdims=True)
            return np.where(total > 0, inside / np.maximum(total, 1e-30), 1 / action.size)
        return inside if isinstance(action, Box) else np.round(inside)

    return space, read
