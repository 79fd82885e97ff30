"""Every number of a pharma case that has a gradient, as `Input`s named "unit.field"."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from snapo.case.given import Given
from snapo.problem.inputs import Input

from .records import PharmaCase


def pharma_inputs(case: PharmaCase) -> dict[str, Input]:
    """{name: Input} of kinetics, feeds and units, without those that the case holds fixed."""
    found: dict[str, Input] = {}
    for given in every_given((case.network, case.feeds, case.units)):
        if given.name in found:
            raise ValueError(f"{given.name}: two inputs of a case share this name.")
        if given.name not in case.held:
            found[given.name] = Input(given.values, given.unit, given.labels)
    return found


def every_entry(inputs: Mapping[str, Any]) -> tuple[tuple[str, int], ...]:
    """(input, position) of all numbers, in order."""
    return tuple((name, i) for name, value in inputs.items() for i in range(np.size(value)))


def every_given(record: Any) -> Iterator[Given]:
    """All numbers given in a record, in the records within it and in tuples of records."""
    if isinstance(record, Given):
        if record.values.size:
            yield record
    elif isinstance(record, tuple):
        for each in record:
            yield from every_given(each)
    elif is_dataclass(record):
        for field in fields(record):
            yield from every_given(getattr(record, field.name))


def use(inputs: dict[str, Any], given: Given) -> Array:
    """The numbers where they are used: input or number held fixed, at `given.index`."""
    if not given.values.size:
        return jnp.zeros(given.index.shape)
    # NumPy's integers of 64 bits are no index where JAX counts with 32.
    index = int(given.index) if given.index.ndim == 0 else given.index.astype(np.int32)
    value = inputs[given.name] if given.name in inputs else fixed(given.values)
    return jnp.asarray(value)[index]


def fixed(array: np.ndarray) -> Array:
    """A table as an array of JAX in the precision of the trace at hand.

    From a copy: JAX keeps one constant for each NumPy array, in the precision that it met first.
    """
    return jnp.asarray(np.array(array, jnp.result_type(float)))
