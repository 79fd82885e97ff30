"""Numbers that the user gave, where they are used."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.case.given import CaseInput


@dataclass(frozen=True, eq=False)
class InputUse:
    """Where the numbers of a `CaseInput` are used; `values`: themselves where they are no input."""

    name: str
    index: np.ndarray
    values: np.ndarray | None


Entry = tuple[str, int]  # the name of a `CaseInput`, and a position in its values


def every_entry(inputs: Mapping[str, Any]) -> tuple[Entry, ...]:
    """All numbers, in order."""
    return tuple((name, i) for name, value in inputs.items() for i in range(np.size(value)))


def use(inputs: Mapping[str, Any], values: CaseInput | InputUse) -> Array:
    """The numbers where they are used: input or number held fixed, at `given.index`."""
    if values.name in inputs:
        value = inputs[values.name]
    elif _held(values).size:
        value = fixed(_held(values))
    else:
        return jnp.zeros(values.index.shape)
    # NumPy's integers of 64 bits are no index where JAX counts with 32.
    index = int(values.index) if values.index.ndim == 0 else values.index.astype(np.int32)
    return jnp.asarray(value)[index]


def absent(inputs: Mapping[str, Any], values: CaseInput | InputUse) -> bool:
    """Whether a term can be left out: its factor is zero and no input."""
    return values.name not in inputs and not _held(values)[values.index].any()


def _held(values: CaseInput | InputUse) -> np.ndarray:
    """The numbers of what is no input."""
    if values.values is None:
        raise KeyError(f"{values.name} is an input, and this form has no numbers of it.")
    return values.values


def fixed(array: np.ndarray) -> Array:
    """A table as an array of JAX in the precision of the trace at hand.

    From a copy: JAX keeps one constant for each NumPy array, in the precision that it met first.
    """
    return jnp.asarray(np.array(array, jnp.result_type(float)))
